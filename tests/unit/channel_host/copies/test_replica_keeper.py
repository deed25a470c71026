"""The keeper of replicas changes flags while the host of another replica, or its answer, is missing."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.copies.replica_directory import ListedReplica, ListedReplicas
from stampede_rt_channel_host.copies.replica_keeper import KeptChannel, ReplicaKeeper
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicaChange
from tests.support.clock import ManualClock

OWNER, FROZEN, SILENT = b"o" * 16, b"f" * 16, b"s" * 16
WAIT_SECONDS_MAX = 30.0


class Store:
    """A store with one channel, which this host owns."""

    on_replicated: Any = None

    def serves(self, hosted: HostedChannel) -> bool:
        return True

    def lease_held(self) -> bool:
        return True


class Directory:
    """A directory with a replica at a frozen host, and a replica in sync that has not reported yet."""

    def __init__(self) -> None:
        self.has_changed = asyncio.Event()
        self.tries_to_add = 0
        self.refusal: StampedeError = Unavailable("every live host holds the channel", reason="NO_HOST")

    async def replicas_of(self, channel_id: bytes) -> ListedReplicas:
        frozen, silent = KnownReplica(FROZEN, 1, False), KnownReplica(SILENT, 1, True)
        replicas = [ListedReplica(frozen, "frozen:1", False), ListedReplica(silent, "silent:1", False)]
        return ListedReplicas(OWNER, 1, replicas)

    async def add_replica(self, channel_id: bytes, epoch: int, *, acknowledged: bool) -> None:
        self.tries_to_add += 1
        raise self.refusal

    async def change(self, channel_id: bytes, epoch: int, change: ReplicaChange) -> None:
        assert (change.host_id, change.in_sync) == (SILENT, False)
        self.has_changed.set()


class FrozenConnection:
    """A connection to a host that never answers."""

    def unary_unary(self, method: str, **_: Any) -> Any:
        return lambda request, timeout: asyncio.get_running_loop().create_future()

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: None

    async def close(self, grace: float | None) -> None:
        pass


def opened(replicas: int) -> HostedChannel:
    policy = Policy(max_items=1, replicas=replicas)
    record = channel_pb2.ChannelRecord(name="cam", epoch=1, incarnation=5, spec=policy_to_spec(policy))
    return HostedChannel(recorded_channel(record), MemoryBudget(2**30), ManualClock().time_unix_nano, lambda _: None)


async def test_the_flag_of_a_silent_replica_is_cleared_while_another_host_is_frozen_and_a_third_one_missing() -> None:
    hosted = opened(replicas=3)
    store: Any = Store()
    directory: Any = Directory()
    identity = HostIdentity(host_id=OWNER, name="h1", boot_incarnation=1)
    keeper = ReplicaKeeper(identity, store, directory, lambda target: FrozenConnection())  # type: ignore[arg-type,return-value]
    store.on_replicated(hosted)
    try:
        async with asyncio.timeout(WAIT_SECONDS_MAX):
            await directory.has_changed.wait()
    finally:
        await keeper.aclose()
    assert directory.tries_to_add >= 1


class DirectoryWithoutHosts(Directory):
    """A directory without a host for a replica."""

    async def replicas_of(self, channel_id: bytes) -> ListedReplicas:
        return ListedReplicas(OWNER, 1, [])


class DirectoryOfTwo(Directory):
    """A directory with two replicas in sync, and no other ones after a removal."""

    def __init__(self) -> None:
        super().__init__()
        self.hosts = [FROZEN, SILENT]

    async def replicas_of(self, channel_id: bytes) -> ListedReplicas:
        return ListedReplicas(
            OWNER, 1, [ListedReplica(KnownReplica(one, 1, True), "replica:1", False) for one in self.hosts]
        )

    async def remove_replica(self, channel_id: bytes, epoch: int, host_id: bytes) -> None:
        self.hosts.remove(host_id)


async def test_a_surplus_replica_counts_no_more_after_its_removal() -> None:
    """In an earlier version it counted until the next list. Meanwhile the owner could clear the flag of the other one,
    and acknowledge puts that only the removed replica had.
    """
    hosted = opened(replicas=1)
    store: Any = Store()
    directory: Any = DirectoryOfTwo()
    kept = KeptChannel(OWNER, store, directory, lambda target: FrozenConnection(), hosted)  # type: ignore[arg-type,return-value]
    await kept.look()
    assert hosted.replication is not None
    assert [*hosted.replication.states()] == directory.hosts == [SILENT]


REFUSALS = {
    "no host is free": Unavailable("every live host holds the channel", reason="NO_HOST"),
    "the owner does not know the policy": InvalidArgument("puts wait for replicas", metadata={"field": "acknowledged"}),
}


@pytest.mark.parametrize("refusal", REFUSALS.values(), ids=REFUSALS)
async def test_an_owner_asks_less_often_while_the_directory_adds_no_replica(
    monkeypatch: pytest.MonkeyPatch, refusal: StampedeError
) -> None:
    store: Any = Store()
    directory: Any = DirectoryWithoutHosts()
    directory.refusal = refusal
    kept = KeptChannel(OWNER, store, directory, lambda target: FrozenConnection(), opened(replicas=1))  # type: ignore[arg-type,return-value]
    tried_at_s = []
    for now_s in range(1000, 1040):
        monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda now_s=now_s: float(now_s))
        before = directory.tries_to_add
        await kept.look()
        if directory.tries_to_add > before:
            tried_at_s.append(now_s - 1000)
    assert tried_at_s == [0, 2, 6, 14, 24, 34]
