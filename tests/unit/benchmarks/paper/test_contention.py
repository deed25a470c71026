"""How `stampede bench paper --figure contention` counts dropped frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt_bench.measuring import Effort
from stampede_rt_bench.paper import contention
from stampede_rt_bench.workloads.catalogue import LARGE, MEDIUM, Workload, frames
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.run import count_lost

FRAMES = 15


def test_consumers_that_take_turns_at_the_newest_frame_get_frames_of_a_real_channel() -> None:
    lost = count_lost(contention.NewestByTurns(), frames(MEDIUM, 2, items_total=FRAMES))
    assert len(lost) == 2
    assert all(0 <= one < FRAMES for one in lost)


def test_the_table_has_the_mean_drops_of_all_consumers_and_the_most_drops_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workloads: list[Workload] = []
    runs = iter([[1, 2, 0], [3, 0, 0]])

    def count(system: MeasuredSystem, workload: Workload) -> list[int]:
        workloads.append(workload)
        return next(runs)

    monkeypatch.setattr(contention, "count_lost", count)
    monkeypatch.setattr(contention, "CONSUMERS", {LARGE: (16,)})
    chart = tmp_path / "chart.png"
    table = contention.measure(Effort(items_max=1, runs=2, frames=FRAMES), chart)
    assert table.rows == [["300 KB", "16", "3.0; 3 (3 to 3)", "3", "about 17 % of all", "549"]]
    assert chart.exists()
    assert [(workload.readers, workload.items_total, workload.rate) for workload in workloads] == [(16, FRAMES, 30)] * 2
