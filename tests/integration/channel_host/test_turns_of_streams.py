"""Streams of every kind whose caller is beyond its share of the host's time: their next step waits in line."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import group_pb2, group_service_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.v1.group_service_pb2_grpc import GroupServiceStub
from stampede_rt.v1.queue_service_pb2_grpc import QueueServiceStub
from stampede_rt_runtime.access import control
from stampede_rt_runtime.quotas import loop_shares
from stampede_rt_runtime.quotas.accounts import Accounts
from stampede_rt_runtime.quotas.loop_shares import LoopShare
from tests.support.channel_host.group_rig import GroupedChannel, Host, running_cluster
from tests.support.channel_host.queue_rig import QueueRig, running_queue_host
from tests.support.channel_host.queue_rig import run_of as queue_run_of
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, S, between

FAR = MAX_INSTANT
WAIT_SECONDS = 15.0


@pytest.fixture(autouse=True)
def each_connection_is_a_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control, "subject_of", lambda caller, peer: peer)
    monkeypatch.setattr(loop_shares, "CONTENDED_NANOS", 3600 * S)


class HeavyCaller:
    """A connection whose caller comes to use up its share."""

    def __init__(self, target: str, accounts: Accounts) -> None:
        self.connection = grpc.aio.insecure_channel(target)
        self._accounts = accounts
        self._known = {use.subject for use in accounts.uses()}

    def overspend(self) -> LoopShare:
        """Put the callers of all open streams beyond their share. Only this connection has open streams."""
        (subject,) = {use.subject for use in self._accounts.uses() if str(use.quota) == "streams" and use.used}
        found = self._accounts.of(subject).loop_share
        other = self._accounts.of("other").loop_share
        assert found is not None
        assert other is not None
        other.spend(1)
        found.spend(3600 * S)
        return found


async def waits_in_line(loop_share: LoopShare, work: Callable[[], Awaitable[object]]) -> None:
    """Do good clients' work until a step of the heavy caller waits for its turn."""
    async with asyncio.timeout(WAIT_SECONDS):
        while not loop_share.has_line:
            await work()


@pytest.fixture
async def host() -> AsyncIterator[Host]:
    async with running_cluster() as cluster:
        yield await cluster.start("h1", b"host-number-one!")


def subscription(call: Any, left: GroupedChannel, group: group_pb2.GroupRecord) -> Any:
    opened = pb.SubscribeOpen(channel_id=left.channel_id, epoch=1)
    return ChannelServiceStub(call).Subscribe, pb.SubscribeRequest(open=opened, credit_bytes=FAR)


def cuts(call: Any, left: GroupedChannel, group: group_pb2.GroupRecord) -> Any:
    opened = group_service_pb2.SubscribeCutsOpen(group_id=group.group_id, decides=True)
    return GroupServiceStub(call).SubscribeCuts, group_service_pb2.SubscribeCutsRequest(open=opened, credit=1000)


def matches(call: Any, left: GroupedChannel, group: group_pb2.GroupRecord) -> Any:
    opened = group_service_pb2.SubscribeMatchesOpen(
        group_id=group.group_id, per_channel_id=left.channel_id, epoch=1, tolerance_nanos=S
    )
    return GroupServiceStub(call).SubscribeMatches, group_service_pb2.SubscribeMatchesRequest(
        open=opened, credit_bytes=2**40
    )


@pytest.mark.parametrize("kind", [subscription, cuts, matches])
async def test_a_reader_of_a_busy_caller_waits_for_its_turn_before_its_next_message(host: Host, kind: Any) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    heavy = HeavyCaller(host.target, host.accounts)
    method, request = kind(heavy.connection, left, group)
    call = method()
    await call.write(request)
    await call.read()
    loop_share = heavy.overspend()

    async def put() -> None:
        nonlocal t
        t += 1
        await left.put(t)
        await right.put(t)

    await waits_in_line(loop_share, put)
    await heavy.connection.close()


async def test_a_get_waits_for_its_turn_before_it_is_read(host: Host) -> None:
    left = await host.open("left")
    heavy = HeavyCaller(host.target, host.accounts)
    call: Any = ChannelServiceStub(heavy.connection).Get()
    request = pb.GetRequest(call_id=1, channel_id=left.channel_id, epoch=1, interval=between(MIN_INSTANT, MAX_INSTANT))
    await call.write(request)
    await call.read()
    loop_share = heavy.overspend()
    await call.write(request)
    await waits_in_line(loop_share, lambda: left.put(host.now()))
    await heavy.connection.close()


@pytest.fixture
async def rig() -> AsyncIterator[QueueRig]:
    async with running_queue_host() as rig:
        yield rig


async def test_a_taker_waits_for_its_turn_before_it_gets_its_next_message(rig: QueueRig) -> None:
    queue = rig.open()
    heavy = HeavyCaller(rig.target, rig.accounts)
    call: Any = QueueServiceStub(heavy.connection).Take()
    opened = queue_pb.TakeOpen(queue_id=queue.queue_id, epoch=queue.record.epoch, taker_id=1)
    await call.write(queue_pb.TakeRequest(open=opened, credit=100))
    await call.read()
    loop_share = heavy.overspend()
    await waits_in_line(loop_share, lambda: queue.put(b"x"))
    await heavy.connection.close()


async def test_a_settlement_waits_for_the_turn_of_its_taker(rig: QueueRig) -> None:
    queue = rig.open()
    heavy = HeavyCaller(rig.target, rig.accounts)
    call: Any = QueueServiceStub(heavy.connection).Take()
    opened = queue_pb.TakeOpen(queue_id=queue.queue_id, epoch=queue.record.epoch, taker_id=1)
    await call.write(queue_pb.TakeRequest(open=opened))
    await call.read()
    loop_share = heavy.overspend()
    await call.write(queue_pb.TakeRequest(credit=1))
    await waits_in_line(loop_share, queue.status)
    await heavy.connection.close()


async def test_an_enqueue_waits_for_its_turn_before_the_host_checks_it(rig: QueueRig) -> None:
    queue = rig.open()
    heavy = HeavyCaller(rig.target, rig.accounts)
    call: Any = QueueServiceStub(heavy.connection).Enqueue()
    await call.write(queue.enqueue_request(queue_run_of(b"x")))
    await call.read()
    loop_share = heavy.overspend()
    await call.write(queue.enqueue_request(queue_run_of(b"y")))
    await waits_in_line(loop_share, queue.status)
    assert (await queue.status()).counters.accepted == 1
    await heavy.connection.close()


async def test_a_get_that_is_too_long_is_refused_immediately_and_does_not_wait_for_its_turn(host: Host) -> None:
    left = await host.open("left")
    heavy = HeavyCaller(host.target, host.accounts)
    call: Any = heavy.connection.stream_stream("/stampede_rt.v1.ChannelService/Get")()
    request = pb.GetRequest(call_id=1, channel_id=left.channel_id, epoch=1, interval=between(MIN_INSTANT, MAX_INSTANT))
    await call.write(request.SerializeToString())
    await call.read()
    loop_share = heavy.overspend()
    await call.write(bytes(200_000))
    async with asyncio.timeout(WAIT_SECONDS):
        assert await call.code() is grpc.StatusCode.INVALID_ARGUMENT
    assert "has 200000 bytes" in await call.details()
    assert not loop_share.has_line
    await heavy.connection.close()
