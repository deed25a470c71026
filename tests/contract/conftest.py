"""Every test of this folder runs on the core in memory and over gRPC, synchronous and asynchronous."""

from __future__ import annotations

from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.contract.memory import MemoryConnection
from tests.contract.surfaces import Surface
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=1, supernodes=1, scope="session")


@pytest.fixture(params=["memory", "aio", "sync"])
async def surface(request: pytest.FixtureRequest) -> AsyncIterator[Surface]:
    if request.param == "memory":
        yield Surface(MemoryConnection())
        return
    running: LocalCluster = request.getfixturevalue("cluster")
    if request.param == "aio":
        async with aio.connect(running.address) as connection:
            yield Surface(connection)
        return
    with st.connect(running.address) as blocking, ThreadPoolExecutor(16) as pool:
        yield Surface(blocking, pool)
