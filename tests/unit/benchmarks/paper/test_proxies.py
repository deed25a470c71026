"""How `stampede bench paper --figure proxies` measures readers with proxies and without."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt_bench.measuring import Effort
from stampede_rt_bench.paper import proxies
from stampede_rt_bench.workloads.catalogue import MEDIUM, Workload, frames
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.run import RunResult, measure


def test_readers_of_a_channel_with_a_proxy_get_its_frames() -> None:
    measured = measure(proxies.WithProxies(proxies=1), frames(MEDIUM, 2), 0.5)
    assert measured.items_per_second > 0
    assert all(0 <= one < 2 for one in measured.server_cores[:2])


def test_the_table_has_the_lost_frames_and_the_cpu_time_of_each_host(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments: list[tuple[int, int]] = []

    def run(system: MeasuredSystem, workload: Workload, seconds: float) -> RunResult:
        assert isinstance(system, proxies.WithProxies)
        arguments.append((workload.readers, system.proxies))
        cores = (0.5, 0.25, 0.125)[: 1 + system.proxies]
        return RunResult(
            seconds=seconds, items_per_second=1, cpu_us_per_item=1, lost_share=0.1 / (1 + system.proxies),
            server_cores=(*cores, 9.0),
        )  # fmt: skip

    monkeypatch.setattr(proxies, "measure_run", run)
    monkeypatch.setattr(proxies, "unavailable_because", lambda: "no root")
    monkeypatch.setattr(proxies, "READERS", (16,))
    chart = tmp_path / "proxies.png"
    table = proxies.measure(Effort(items_max=1, runs=2), chart)
    assert arguments == [(16, 0)] * 2 + [(16, 1)] * 2 + [(16, 2)] * 2
    assert table.rows == [
        ["16", "0", "10.0 (10.0 to 10.0)", "50 (50 to 50)", ""],
        ["16", "1", "5.0 (5.0 to 5.0)", "50 (50 to 50)", "25 (25 to 25)"],
        ["16", "2", "3.3 (3.3 to 3.3)", "50 (50 to 50)", "25 (25 to 25), 12 (12 to 12)"],
    ]
    assert chart.exists()
    assert (tmp_path / "proxies-cpu.png").exists()
    assert "no root" in table.notes[1]
