"""The rover demo, whole: cameras in the rover's own process, a planner that joins, a drain, a killed host, no loss."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.rover import app
from stampede_rt_demos.rover.orchestrator import conduct
from stampede_rt_demos.rover.programme import SECONDS_MIN
from stampede_rt_demos.rover.report import RoverReport, render
from stampede_rt_demos.staging.progress import Progress
from tests.support.command_line.documented_fields import require_fields


@pytest.fixture(scope="module")
def report() -> RoverReport:
    return conduct(SECONDS_MIN, Progress(io.StringIO()))


def test_the_rover_loses_no_pair_and_makes_no_wrong_pair(report: RoverReport) -> None:
    assert len(report.puts) == report.frames > 0
    assert (report.pairs, report.wrong, report.dropped) == (report.pairs_possible, 0, 0), report.events


def test_a_planner_joins_and_one_host_is_drained_and_another_killed(report: RoverReport) -> None:
    event_texts = " ".join(what for _, what in report.events)
    assert "planner joins" in event_texts
    assert "2 channels move away" in event_texts
    assert "is killed" in event_texts
    assert 0 < report.planner_pairs < report.pairs


def test_the_rover_reads_the_very_objects_that_it_put_while_it_is_the_host(report: RoverReport) -> None:
    assert 0 < report.by_reference < report.frames


def test_commands_reach_the_mailbox_of_the_rover(report: RoverReport) -> None:
    sent, received, _ = report.commands
    assert 0 < received <= sent


def test_the_run_is_described_in_words_and_drawn(report: RoverReport, tmp_path: Path) -> None:
    assert "lost: 0" in render(report)
    from stampede_rt_demos.rover.picture import draw  # not at the top: the import of matplotlib takes a second

    draw(report, tmp_path / "rover.png")
    assert (tmp_path / "rover.png").read_bytes().startswith(b"\x89PNG")


def test_the_json_of_a_run_has_the_fields_that_the_page_names(
    report: RoverReport, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(app, "conduct", lambda *_, **__: report)
    assert app.run(seconds=SECONDS_MIN, picture=None, form="json") == 0
    require_fields("demo rover", capsys.readouterr().out)


def test_a_run_too_short_for_the_outage_is_refused() -> None:
    with pytest.raises(DemoFailed, match="give 16 or more"):
        app.run(seconds=SECONDS_MIN - 1, picture=None)
