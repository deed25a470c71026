"""`stampede bench limits` on a small scale: real servers and processes, no time is judged."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import pytest

from stampede_rt_bench.app import main
from stampede_rt_bench.limits.sockets import RawSockets
from stampede_rt_bench.workloads.catalogue import workloads
from stampede_rt_bench.workloads.run import measure
from tests.support.command_line.documented_fields import require_fields

QUICK = ["--seconds", "0.1", "--rounds", "1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("limits")


@pytest.fixture(scope="module")
def printed(folder: Path) -> str:
    with contextlib.redirect_stdout(io.StringIO()) as output:
        assert main(["limits", "--work", "put", *QUICK, "--out", str(folder), "--output", "json"]) == 0
    return output.getvalue()


def test_the_json_of_limits_has_the_fields_that_the_page_names_and_is_the_written_file(
    printed: str, folder: Path
) -> None:
    require_fields("bench limits", printed)
    assert json.loads(printed) == json.loads((folder / "limits.json").read_text())


def test_limits_are_measured_and_reported(printed: str, folder: Path) -> None:
    page = (folder / "limits.md").read_text()
    assert "| bare Unix socket |" in page
    report = json.loads(printed)
    (workload,) = report["works"]
    assert set(workload["systems"]) == {"bare gRPC", "bare Unix socket", "bare TCP socket"}
    assert all(system["items_per_second"]["median"] > 0 for system in workload["systems"].values())
    assert report["failures"] == []
    assert (folder / "limits-operations.png").exists()


@pytest.mark.parametrize("name", ["newest", "interval", "stream-18kb", "latency-300"])
def test_a_run_moves_items_and_loses_none(name: str) -> None:
    (workload,) = [workload for workload in workloads() if workload.name == name]
    measured = measure(RawSockets("unix"), workload, 0.1)
    assert measured.items_per_second > 0
    assert measured.lost_share == 0
    assert (measured.p50_us > 0) is (workload.kind != "stream")


def test_an_unknown_work_is_refused_with_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["limits", "--work", "shouting"])
    assert "stream-18kb" in capsys.readouterr().err


def test_a_time_out_of_range_is_refused_with_the_range(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["limits", "--seconds", "0"])
    assert "from 0.1 to 600" in capsys.readouterr().err
