"""What participants know of their own clocks, and of each other's. Both clients; the core in memory has no peers."""

from __future__ import annotations

from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.contract.surfaces import Surface

MINUTE_NANOS = 60 * 10**9
NAME = "clocks/one"


@pytest.fixture(params=["aio", "sync"])
async def named(request: pytest.FixtureRequest, cluster: LocalCluster) -> AsyncIterator[Any]:
    """A named connection, to be awaited."""
    if request.param == "aio":
        async with aio.connect(cluster.address, name=NAME) as connection:
            yield connection
        return
    with st.connect(cluster.address, name=NAME) as blocking, ThreadPoolExecutor(4) as pool:
        yield Surface(blocking, pool).connection


def is_right(clock: st.ClockOffset | None) -> bool:
    """All are on one machine, so that the true offset is 0."""
    assert clock is not None
    return abs(clock.offset_nanos) <= clock.uncertainty_nanos <= MINUTE_NANOS


async def test_a_participant_knows_its_clock_once_it_is_connected_and_the_others_do_too(named: Any) -> None:
    assert is_right(named.clock)
    [listed] = await named.peers(NAME)
    assert is_right(listed.clock)
    found = await named.peer(NAME)
    assert is_right(found.clock)
    assert found.clock.supernode in [supernode.supernode_id for supernode in await named.supernodes()]
