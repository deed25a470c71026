"""Every test of this folder runs on the core in memory, and over each transport with both clients."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.contract.memory import MemoryConnection
from tests.contract.surfaces import Surface, connected
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=1, supernodes=1, scope="session")
grouped_cluster = cluster_fixture(hosts=2, supernodes=1)


@pytest.fixture(params=["grpc", "socket"], autouse=True)
def transport(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The transport that each client of a test must use."""
    monkeypatch.setenv("STAMPEDE_TRANSPORT", request.param)
    return str(request.param)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep one of the tests of the core in memory, which has no transport."""
    items[:] = [item for item in items if not {"memory", "socket"} <= _parameters(item)]


def _parameters(item: pytest.Item) -> set[str]:
    parameters = item.callspec.params.values() if hasattr(item, "callspec") else ()
    return {one for one in parameters if isinstance(one, str)}


@pytest.fixture(params=["memory", "aio", "sync"])
async def surface(request: pytest.FixtureRequest) -> AsyncIterator[Surface]:
    if request.param == "memory":
        yield Surface(MemoryConnection())
        return
    running: LocalCluster = request.getfixturevalue("cluster")
    async with connected(request.param, running.address) as surface:
        yield surface
