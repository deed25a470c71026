"""`stampede bench peers` with the real servers that are on this machine; no time is judged here."""

from __future__ import annotations

import pytest

from stampede_rt_bench.comparison import SYSTEMS
from stampede_rt_bench.works.catalogue import works
from stampede_rt_bench.works.run import measure

WORKS = {work.name: work for work in works()}
SECONDS = 0.1
STREAMING = ["stampede", "redis", "nats", "jetstream", "zenoh-router", "zenoh-shm"]
KEEPING = ["redis-unix", "jetstream", "zenoh-router"]


@pytest.mark.parametrize(
    ("name", "work"), [(name, "stream-18kb") for name in STREAMING] + [(name, "interval") for name in KEEPING]
)
def test_a_peer_does_the_work_and_loses_nothing(name: str, work: str) -> None:
    system = SYSTEMS[name]
    if reason := system.unavailable_because():
        pytest.skip(reason)
    measured = measure(system, WORKS[work], SECONDS)
    assert measured.items_per_second > 0
    assert measured.lost_share == 0


def test_every_system_does_every_kind_of_work_or_says_why_not() -> None:
    kinds = {work.kind for work in works()}
    for system in SYSTEMS.values():
        assert set(system.lacks) < kinds
        assert all(system.lacks.values())
