"""`stampede bench peers` with the real servers that are on this machine; no time is judged here."""

from __future__ import annotations

import contextlib

import pytest

from stampede_rt_bench.comparison import SYSTEMS
from stampede_rt_bench.workloads.catalogue import Workload, workloads
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.run import RunFailed, RunResult, measure

WORKLOADS = {workload.name: workload for workload in workloads()}
SECONDS = (0.1, 1.0, 5.0)
STREAMING = ["stampede", "stampede-embedded", "redis", "nats", "jetstream", "zenoh-router", "zenoh-shm"]
KEEPING = ["redis-unix", "jetstream", "zenoh-router"]


@pytest.mark.parametrize(
    ("name", "workload"), [(name, "stream-18kb") for name in STREAMING] + [(name, "interval") for name in KEEPING]
)
def test_a_peer_does_the_work_and_loses_nothing(name: str, workload: str) -> None:
    system = SYSTEMS[name]
    if reason := system.unavailable_because():
        pytest.skip(reason)
    measured = measured_without_haste(system, WORKLOADS[workload])
    assert measured.items_per_second > 0
    assert measured.lost_share == 0


def measured_without_haste(system: MeasuredSystem, workload: Workload) -> RunResult:
    """Measure for a moment. Measure for longer if a busy machine delivered nothing in that moment, or delivered the
    last items too late.
    """
    for seconds in SECONDS[:-1]:
        with contextlib.suppress(RunFailed):
            measured = measure(system, workload, seconds)
            if not measured.lost_share:
                return measured
    return measure(system, workload, SECONDS[-1])


def test_every_system_does_every_kind_of_work_or_says_why_not() -> None:
    kinds = {workload.kind for workload in workloads()}
    for system in SYSTEMS.values():
        assert set(system.unsupported) < kinds
        assert all(system.unsupported.values())
