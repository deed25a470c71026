"""A host's callers that reach their quotas, over gRPC with the generated stubs.

The host names all of them by this machine's address, because it asks for no credential.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_pb2, error_pb2, gatekeeper_service_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt_channel_host.core.channel import consumer_places
from stampede_rt_channel_host.core.dedup import RetryWindow
from stampede_rt_channel_host.core.run_outcome import RunOutcome
from stampede_rt_runtime.access import control
from stampede_rt_runtime.quotas.limits import Quota
from tests.support.channel_host.queue_rig import run_of as queue_run_of
from tests.support.channel_host.queue_rig import running_queue_host
from tests.support.channel_host.rig import FOREVER, OpenedChannel, Rig, S, run_of, running_host

CREATORS = {"a": "cam", "b": "cam", "c": "other"}
REFUSED = error_pb2.ERROR_REASON_OVERLOADED


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


SENDING_STILL = "Internal error from Core"  # the error text of grpc.aio itself


async def refusal_of(begin: Callable[[], Any]) -> Overloaded:
    """The error with which a stream ends.

    Begins the stream again if grpc.aio was still sending at its end, because grpc.aio then loses the answer.
    """
    details: str | None = SENDING_STILL
    while details == SENDING_STILL:
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await begin().read()
        details = caught.value.details()
    assert caught.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
    error = from_rpc_error(caught.value, "")
    assert isinstance(error, Overloaded)
    return error


def full_channel() -> channel_pb2.ChannelSpec:
    retention = channel_pb2.RetentionPolicy(max_items=1, max_age_nanos=600 * S)
    return channel_pb2.ChannelSpec(retention=retention, on_full=channel_pb2.ON_FULL_BLOCK)


async def subscribed(channel: OpenedChannel) -> Any:
    call = channel.subscribe()
    assert (await call.read()).HasField("opened")
    return call


async def test_subscriptions_above_the_quota_are_refused_and_other_streams_are_not(rig: Rig) -> None:
    rig.accounts.set_default(Quota.SUBSCRIPTIONS, 2)
    channel = await rig.open()
    held = [await subscribed(channel) for _ in range(2)]
    error = await refusal_of(channel.subscribe)
    assert error.metadata["quota"] == "subscriptions"
    assert "stampede quota set @" in error.message
    (ack,) = await channel.put(run_of(b"x"))
    assert ack.first_seq == 1
    held[0].cancel()
    await channel.until(lambda status: status.subscriptions == 1)
    await subscribed(channel)


async def test_streams_above_the_quota_are_refused_and_single_calls_are_not(rig: Rig) -> None:
    rig.accounts.set_default(Quota.STREAMS, 1)
    channel = await rig.open()
    held = await subscribed(channel)
    assert (await refusal_of(rig.channels.Get)).metadata["quota"] == "streams"
    assert (await channel.status()).subscriptions == 1
    held.cancel()


async def test_waiting_gets_above_the_quota_are_refused_until_others_end(rig: Rig) -> None:
    rig.accounts.set_default(Quota.WAITING_CALLS, 2)
    channel = await rig.open()
    call = rig.channels.Get()
    for call_id in (1, 2, 3):
        await call.write(channel.newest_request(call_id, wait_nanos=FOREVER))
    response = await call.read()
    assert response.call_id == 3
    assert (response.error.reason, response.error.metadata["quota"]) == (REFUSED, "waiting-calls")
    await channel.put(run_of(b"x"))
    assert {(await call.read()).call_id for _ in range(2)} == {1, 2}
    await call.write(channel.newest_request(4))
    assert (await call.read()).summary.complete is not None
    call.cancel()


async def test_a_broken_stream_of_gets_gives_back_the_quota_of_its_waiting_gets(rig: Rig) -> None:
    rig.accounts.set_default(Quota.WAITING_CALLS, 5)
    channel = await rig.open()
    call = rig.channels.Get()
    for call_id in range(4):
        await call.write(channel.newest_request(call_id + 1, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 4)
    call.cancel()
    await channel.until(lambda status: status.waiting_gets == 0)
    await channel.until(lambda status: not rig.accounts.uses())


async def test_a_put_above_the_quota_of_waiting_puts_is_refused_unless_it_finds_room_immediately(rig: Rig) -> None:
    channel, other = await rig.open(spec=full_channel()), await rig.open("other")
    await channel.put(run_of(b"x"))
    rig.accounts.set_default(Quota.BYTES_IN_FLIGHT, 10_000)
    call = rig.channels.Put()
    known = {"channel_id": channel.channel_id, "epoch": channel.epoch}
    await call.write(pb.PutRequest(puts=[run_of(bytes(9_000), number=2)], **known))
    await channel.until(lambda status: status.waiting_puts == 1)
    (ack,) = await channel.put(run_of(bytes(9_000)))
    assert (ack.error.reason, ack.error.metadata["quota"]) == (REFUSED, "bytes-in-flight")
    (ack,) = await other.put(run_of(bytes(9_000)))
    assert ack.first_seq == 1
    status = await channel.status()
    assert (status.waiting_puts, status.counters.rejected_overloaded) == (1, 1)
    call.cancel()
    await channel.until(lambda status: status.waiting_puts == 0)


async def test_unread_answers_count_as_bytes_in_flight() -> None:
    async with running_host() as rig:
        channel = await rig.open()
        for number in range(8):
            await channel.put(run_of(bytes(2**20), number=number + 1))
        rig.accounts.set_default(Quota.BYTES_IN_FLIGHT, 9 * 2**20)
        silent = [rig.channels.Get() for _ in range(3)]
        for call in silent:
            for call_id in (1, 2):
                await call.write(channel.get_request(call_id))
        await channel.until(lambda status: any(use.refused for use in rig.accounts.uses()))
        for call in silent:
            call.cancel()


async def test_the_bytes_of_a_channel_count_for_the_caller_that_made_the_channel(rig: Rig) -> None:
    mine, also_mine, others = [await rig.open(name, created_by=creator) for name, creator in CREATORS.items()]
    rig.accounts.set_default(Quota.BYTES_HELD, 10_000)
    (ack,) = await mine.put(run_of(bytes(6_000)))
    assert ack.first_seq == 1
    (ack,) = await also_mine.put(run_of(bytes(6_000)))
    assert (ack.error.reason, ack.error.metadata["quota"]) == (REFUSED, "bytes-held")
    assert ack.error.message.startswith("cam has ")
    (ack,) = await others.put(run_of(bytes(6_000)))
    assert ack.first_seq == 1
    request = gatekeeper_service_pb2.DropChannelRequest(
        channel_id=mine.channel_id, epoch=mine.epoch, request_id=b"0123456789abcdef"
    )
    await rig.gate.DropChannel(request)
    (ack,) = await also_mine.put(run_of(bytes(6_000)))
    assert ack.first_seq == 1


async def test_a_waiting_enqueue_above_the_quota_ends_its_stream() -> None:
    async with running_queue_host() as rig:
        queue = rig.open(max_items=1)
        await queue.put(b"x")
        rig.accounts.set_default(Quota.WAITING_CALLS, 0)
        request = queue.enqueue_request(queue_run_of(b"y"))
        assert (await refusal_of(lambda: rig.stub.Enqueue(iter((request,))))).metadata["quota"] == "waiting-calls"
        rig.accounts.set_default(Quota.WAITING_CALLS, 10)
        assert (await queue.status()).counters.rejected_overloaded >= 1


async def test_much_work_of_one_caller_does_not_delay_the_puts_of_another_one(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "subject_of", lambda caller, peer: peer)  # each connection is its own caller
    rig.accounts.set_default(Quota.CPU_PERCENT, 10)
    channel = await rig.open()
    request = pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"x")] * 16)
    answered = 0

    async def put_again_and_again(call: Any) -> None:
        nonlocal answered
        while True:
            await call.write(request)
            acked = 0
            while acked < len(request.puts):
                acked += len((await call.read()).acks)
            answered += 1

    await channel.put(run_of(b"x"))
    async with grpc.aio.insecure_channel(rig.target) as connection:
        stub: Any = ChannelServiceStub(connection)
        busy = [asyncio.create_task(put_again_and_again(stub.Put())) for _ in range(20)]
        for number in range(20):
            (ack,) = await channel.put(run_of(b"good", number=number + 1))
            assert ack.first_seq > 0
        assert answered < 20 * 20  # without turns each of the 20 streams has an answer for each of the 20 good puts
        for task in busy:
            task.cancel()
        await asyncio.gather(*busy, return_exceptions=True)


async def test_a_caller_with_its_share_of_consumer_places_gets_no_further_one(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(consumer_places, "PLACES_OF_ONE_MAX", 1)
    monkeypatch.setattr(control, "owner_name", lambda: "greedy")
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(consumers=3)))
    stub: Any = ChannelServiceStub(rig.connection)
    calls = [
        pb.ConsumeRequest(channel_id=channel.channel_id, epoch=channel.epoch, consumer_id=one) for one in (7, 8, 9)
    ]
    await stub.Consume(calls[0], timeout=10)
    with pytest.raises(grpc.aio.AioRpcError, match="greedy has 1 of the channel's 3 consumer places") as caught:
        await stub.Consume(calls[1], timeout=10)
    assert caught.value.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
    monkeypatch.setattr(control, "owner_name", lambda: "other")
    await stub.Consume(calls[2], timeout=10)


async def test_the_host_counts_the_kept_answers_of_a_producer_for_its_caller(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    owners: list[str] = []
    record = RetryWindow.record

    def noting(window: RetryWindow, producer_id: int, first_number: int, outcome: RunOutcome, owner: str = "") -> None:
        owners.append(owner)
        record(window, producer_id, first_number, outcome, owner)

    monkeypatch.setattr(RetryWindow, "record", noting)
    monkeypatch.setattr(control, "owner_name", lambda: "cam")
    channel = await rig.open()
    await channel.put(run_of(b"x"))
    async with running_queue_host() as queues:
        await queues.open().put(b"x")
    assert owners == ["cam", "cam"]
