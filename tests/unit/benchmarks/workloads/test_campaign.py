"""How systems are compared, without measuring anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

from stampede_rt_bench.workloads.campaign import Results, compare
from stampede_rt_bench.workloads.catalogue import Workload, frames, workloads
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.report import Report
from stampede_rt_bench.workloads.run import RunResult

WORKLOADS = {workload.name: workload for workload in workloads()}
PUT, STREAM = WORKLOADS["put"], WORKLOADS["stream-64b"]


def measured(rate: float = 1, p50_us: float = 1, lost: float = 0) -> RunResult:
    return RunResult(seconds=1, items_per_second=rate, cpu_us_per_item=1, p50_us=p50_us, p99_us=1, lost_share=lost)


def results(by_workload: dict[Workload, dict[str, list[RunResult]]]) -> Results:
    return Results(runs=by_workload)


def test_a_system_with_half_the_time_or_twice_the_rate_is_twice_as_fast() -> None:
    found = results(
        {
            PUT: {"a": [measured(p50_us=10)], "b": [measured(p50_us=20)]},
            STREAM: {"a": [measured(rate=200)], "b": [measured(rate=100)]},
        }
    )
    assert found.speed(PUT, "a", "b") == found.speed(STREAM, "a", "b") == 2


def test_most_readers_is_the_largest_number_of_readers_with_a_small_median_loss() -> None:
    few, many = frames(64, 8), frames(64, 16)
    found = results({few: {"a": [measured()]}, many: {"a": [measured(lost=0.5), measured(), measured(lost=0.02)]}})
    assert found.most_readers([few, many], "a", 0.01) == 8
    assert found.most_readers([few, many], "a", 0.05) == 16


class Absent:
    name, unsupported = "Absent", {}

    def unavailable_because(self) -> str:
        return "absent-server is not installed; apt-get install absent"


def test_an_absent_system_is_reported_and_the_others_are_measured() -> None:
    lines: list[str] = []
    finished: list[Workload] = []
    found = compare(
        [cast(MeasuredSystem, Absent())],
        [PUT],
        rounds=1,
        seconds=1,
        done=lambda _, workload: finished.append(workload),
        report=lines.append,
    )
    assert lines == ["Absent is not measured: absent-server is not installed; apt-get install absent"]
    assert finished == [PUT]
    assert found.absent == {"Absent": "absent-server is not installed; apt-get install absent"}


def test_a_report_gives_ratios_to_ours_and_to_the_limits(tmp_path: Path) -> None:
    by_system = {name: [measured(rate=rate)] for name, rate in (("ours", 50.0), ("peer", 25.0), ("bare", 100.0))}
    found = results({STREAM: by_system, frames(18_000, 8): {"ours": [measured()]}})
    settings: Any = {"command": "c", "machine": {"cores": "2"}, "rounds": 1, "seconds": 1.0, "unsupported": {}}
    report = Report(name="r", title="T", ours="ours", limits=["bare"], **settings)
    report.write(found, tmp_path)
    text = (tmp_path / "r.md").read_text()
    peer = next(line for line in text.splitlines() if line.startswith("| peer"))
    assert peer.endswith("| 2 | 0.25 |")
    assert "| ours | 8 of 8 tried |" in text
    assert {path.suffix for path in tmp_path.iterdir()} == {".md", ".json", ".png"}
