"""`stampede bench capacity` on a small scale: it measures and reports. No time is judged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stampede_rt_bench.app import main
from stampede_rt_bench.capacity.command import capacity_workloads
from stampede_rt_bench.capacity.memory import EMPTY, KINDS
from tests.support.command_line.documented_fields import require_fields

TITLE = "64 B, each put waits for its ack"


def test_rates_and_memory_of_a_host_are_measured_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ["--work", "memory", "--work", "put-64b", "--seconds", "0.1", "--rounds", "2", "--items", "200"]
    assert main(["capacity", *small, "--out", str(tmp_path), "-o", "json"]) == 0
    require_fields("bench capacity", capsys.readouterr().out)
    found = json.loads((tmp_path / "capacity.json").read_text())
    assert found["memory_bytes"].keys() == {EMPTY, *KINDS}
    assert found["memory_bytes"][EMPTY]["least"] > 10_000_000
    put = found["works"]["put-64b"]
    assert 0 < put["p50_us"]["least"] <= put["p99_us"]["most"]
    assert 0 <= put["server_cpu_us_per_item"]["median"] <= put["cpu_us_per_item"]["most"]
    assert {"load before", "load after", "processor"} <= found["machine"].keys()
    page = (tmp_path / "capacity.md").read_text()
    for words in (TITLE, *KINDS):
        assert f"| {words} |" in page


def test_the_works_have_puts_and_streams_of_each_size_and_a_latency() -> None:
    kinds = [(workload.kind, workload.item_bytes) for workload in capacity_workloads()]
    sizes = (64, 18_000, 300_000)
    assert kinds == [("put", one) for one in sizes] + [("stream", one) for one in sizes] + [("latency", 64)]
