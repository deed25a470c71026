"""Every test of this folder runs on the core in memory, and over gRPC with the blocking and the asyncio client."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.contract.memory import MemoryConnection
from tests.contract.surfaces import Surface, connected
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=1, supernodes=1, scope="session")
grouped_cluster = cluster_fixture(hosts=2, supernodes=1)


@pytest.fixture(params=["memory", "aio", "sync"])
async def surface(request: pytest.FixtureRequest) -> AsyncIterator[Surface]:
    if request.param == "memory":
        yield Surface(MemoryConnection())
        return
    running: LocalCluster = request.getfixturevalue("cluster")
    async with connected(request.param, running.address) as surface:
        yield surface
