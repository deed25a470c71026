"""Every test of this folder runs on the core in memory, and over each transport with both clients."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator, Iterator

import pytest

from stampede_rt.cluster.connecting import parse_target
from stampede_rt.cluster.embedding import HostOptions, InProcessHost, embedder
from stampede_rt.transports.single_thread_call import STREAMS_VARIABLE
from stampede_rt_local.cluster import LocalCluster
from tests.contract.memory import MemoryConnection
from tests.contract.surfaces import Surface, connected
from tests.support.cluster import cluster_fixture, find_secret_of

cluster = cluster_fixture(hosts=1, supernodes=1, data_ports=True, multicast="239.255.7.5:7585", scope="package")
grouped_cluster = cluster_fixture(hosts=2, supernodes=1, data_ports=True, scope="package")


@pytest.fixture(autouse=True)
def secret(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Clients of a test find the secret of its cluster: both clusters run at the same time."""
    for name in {"cluster", "grouped_cluster"} & {*request.fixturenames}:
        find_secret_of(request.getfixturevalue(name), monkeypatch)


OVER_PUBLIC_STREAMS = ("batches", "puts", "reads", "resumed_streams", "subscriptions", "waiting")
"""The test modules that also run over the public streams of gRPC, which the blocking client uses with some versions of
grpcio.
"""


OVER_SHARED_MEMORY = (
    "batches", "callbacks", "codecs", "puts", "reads", "resumed_streams", "shared_streams", "slow_readers",
    "stepped_clock", "subscriptions", "time_rules", "waiting",
)  # fmt: skip
"""The test modules that also run over shared memory.

The others read nothing from it. For example, reads through groups, and reads of channels with consumers, ask the host.
"""


NOT_OVER_GRPC = ("time_rules",)
"""The test modules that do not run over gRPC. Sockets carry the same messages for the rules of time."""


IN_THE_HOSTS_OWN_PROCESS = ("puts", "reads", "time_rules", "waiting")
"""The test modules that also run in a program that is the host of its channels: puts and gets by reference."""


OVER_TCP = ("batches", "callbacks", "puts", "resumed_streams", "slow_readers", "subscriptions", "taking")
"""The test modules that also run over TCP sockets. Their streams stop, break, or carry long messages."""


HERE = pytest.param("here", marks=pytest.mark.without_rules("a client token cannot host channels"))


@pytest.fixture(params=["grpc", "grpc-public", "socket", "tcp", "shared", HERE], autouse=True)
def transport(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The transport that each client of a test must use."""
    transport, _, streams = str(request.param).partition("-")
    monkeypatch.setenv("STAMPEDE_TRANSPORT", "best" if transport == "here" else transport)
    monkeypatch.setenv(STREAMS_VARIABLE, streams)
    return transport


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep each test of the core in memory once, because the core has no transport. Over the public streams keep only
    some tests.
    """
    items[:] = [item for item in items if _is_wanted(item)]


EVERY_TRANSPORT = "STAMPEDE_EVERY_TRANSPORT" in os.environ
"""Whether each test runs over each transport, also where the transport cannot matter (`make contract`)."""


CANNOT_RUN_OVER = {"renewed_tokens": {"shared"}}
"""The transports that a test module can never use.

A subscription that reads a ring does not reconnect when its token is renewed.
"""


def _is_wanted(item: pytest.Item) -> bool:
    found, module = _parameters(item), item.path.stem.removeprefix("test_")
    if EVERY_TRANSPORT and "here" not in found:
        return ("memory" not in found or "grpc" in found) and not found & CANNOT_RUN_OVER.get(module, set())
    if "grpc-public" in found:
        return "sync" in found and module in OVER_PUBLIC_STREAMS
    if "tcp" in found:
        return "memory" not in found and module in OVER_TCP
    if "shared" in found:
        return "memory" not in found and module in OVER_SHARED_MEMORY
    if "here" in found:
        return "memory" not in found and module in IN_THE_HOSTS_OWN_PROCESS
    if module in NOT_OVER_GRPC and "grpc" in found:
        return "memory" in found
    return not {"memory", "socket"} <= found


def _parameters(item: pytest.Item) -> set[str]:
    parameters = item.callspec.params.values() if hasattr(item, "callspec") else ()
    return {one for one in parameters if isinstance(one, str)}


@pytest.fixture(scope="package")
def in_process_host(cluster: LocalCluster) -> Iterator[InProcessHost]:
    """A host in the process of the tests, which all tests share.

    It is private, so that channels of other transports go to other hosts.
    """
    with pytest.MonkeyPatch.context() as patch:
        find_secret_of(cluster, patch)
        target = parse_target(cluster.address, name="here", secret=None, zone=None)
    made = embedder()(target, HostOptions.parse(None, None, "1GiB", "0s", False, private=True))
    made.start(60)
    yield made
    made.leave()


@pytest.fixture(params=["memory", "aio", "sync"])
async def surface(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, transport: str
) -> AsyncIterator[Surface]:
    if request.param == "memory":
        yield Surface(MemoryConnection())
        return
    running: LocalCluster = request.getfixturevalue("cluster")
    find_secret_of(running, monkeypatch)
    async with connected(request.param, running.address) as surface:
        if transport == "here":
            surface.live_in(request.getfixturevalue("in_process_host"))
        yield surface
