"""ChannelService.Consume at a host: places, leases, and puts that wait for consumption."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from tests.support.channel_host.rig import MS, OpenedChannel, Rig, S, run_of, running_host

ANN, BOB = 11, 22


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def consumed_channel(rig: Rig, *payloads: bytes, on_full: Any = None, **retention: int) -> OpenedChannel:
    spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(**retention), on_full=on_full)
    channel = await rig.open("a", spec)
    if payloads:
        await channel.put(run_of(*payloads))
    return channel


def consume(channel: OpenedChannel, consumer_id: int, *seqs: int, **fields: Any) -> Any:
    fields = {"epoch": channel.epoch, "incarnation": channel.incarnation, **fields}
    request = pb.ConsumeRequest(channel_id=channel.channel_id, consumer_id=consumer_id, seqs=seqs, **fields)
    return channel.rig.channels.Consume(request)


async def test_items_are_collected_when_all_consumers_have_consumed_them(rig: Rig) -> None:
    channel = await consumed_channel(rig, b"one", b"two", b"three", consumers=2)
    first = await consume(channel, ANN, 1, 2)
    assert (first.consumed, first.lease_nanos) == (2, 10 * S)
    assert (await consume(channel, ANN, 1, 2)).consumed == 0, "a retry changes nothing"
    assert (await consume(channel, BOB, 1, lease_nanos=60 * S)).lease_nanos == 60 * S
    assert (await channel.get()).payloads == [b"two", b"three"]
    status = await channel.status()
    assert (status.counters.held, status.counters.collected_by_consumption) == (2, 1)
    assert {one.consumer_id: one.waiting for one in status.consumers} == {ANN: 1, BOB: 2}
    assert all(0 < one.lease_nanos <= 60 * S for one in status.consumers)


async def test_a_consumer_above_the_limit_is_refused_until_another_one_gives_up_its_place(rig: Rig) -> None:
    channel = await consumed_channel(rig, b"one", consumers=1)
    await consume(channel, ANN)
    with pytest.raises(grpc.aio.AioRpcError, match="all places are taken") as refused:
        await consume(channel, BOB, 1)
    assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
    await consume(channel, ANN, lease_nanos=0)
    assert (await consume(channel, BOB, 1)).consumed == 1


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"incarnation": 5}, grpc.StatusCode.DATA_LOSS),
        ({"epoch": 77}, grpc.StatusCode.FAILED_PRECONDITION),
        ({"consumer_id": 0}, grpc.StatusCode.INVALID_ARGUMENT),
        ({"lease_nanos": -1}, grpc.StatusCode.INVALID_ARGUMENT),
        ({"seqs": [2]}, grpc.StatusCode.INVALID_ARGUMENT),
    ],
)
async def test_a_wrong_request_is_refused_with_the_right_status_code(
    rig: Rig, fields: dict[str, Any], code: grpc.StatusCode
) -> None:
    channel = await consumed_channel(rig, b"one", consumers=1)
    fields = {"consumer_id": ANN, "epoch": channel.epoch, "seqs": [1], **fields}
    with pytest.raises(grpc.aio.AioRpcError) as refused:
        await rig.channels.Consume(pb.ConsumeRequest(channel_id=channel.channel_id, **fields))
    assert refused.value.code() is code
    assert not (await channel.status()).consumers


async def test_a_put_waits_until_consumption_makes_room(rig: Rig) -> None:
    channel = await consumed_channel(rig, b"one", b"two", consumers=1, max_items=2, on_full=channel_pb2.ON_FULL_BLOCK)
    await consume(channel, ANN)
    waiting = asyncio.create_task(channel.put(run_of(b"three")))
    await channel.until(lambda status: status.waiting_puts == 1)
    await consume(channel, ANN, 1)
    assert (await waiting)[0].first_seq == 3
    assert (await channel.get()).payloads == [b"two", b"three"]


async def test_a_put_waits_no_longer_than_the_lease_of_a_consumer_that_died(rig: Rig) -> None:
    channel = await consumed_channel(rig, b"one", b"two", consumers=1, max_items=2, on_full=channel_pb2.ON_FULL_BLOCK)
    await consume(channel, ANN, lease_nanos=50 * MS)
    async with asyncio.timeout(45):
        assert (await channel.put(run_of(b"three")))[0].first_seq == 3
    assert (await channel.get()).payloads == [b"three"]


async def test_a_waiting_put_is_accepted_when_the_directory_lowers_the_number_of_consumers(rig: Rig) -> None:
    channel = await consumed_channel(rig, b"one", b"two", consumers=2, max_items=2, on_full=channel_pb2.ON_FULL_BLOCK)
    await consume(channel, ANN, 1)
    waiting = asyncio.create_task(channel.put(run_of(b"three")))
    await channel.until(lambda status: status.waiting_puts == 1)
    spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(consumers=1))
    await rig.gate.ConfigureChannel(
        gate_pb.ConfigureChannelRequest(
            request_id=bytes(16), channel_id=channel.channel_id, epoch=channel.epoch, spec=spec
        )
    )
    assert (await waiting)[0].first_seq == 3


async def test_old_items_are_kept_for_a_consumer_that_lags(rig: Rig) -> None:
    channel = await consumed_channel(rig, max_age_nanos=1, max_age_unconsumed_nanos=3600 * S)
    await consume(channel, ANN)
    for number in range(3):
        await channel.put(run_of(b"%d" % number))
    assert (await channel.status()).counters.held == 3
    await consume(channel, ANN, 1, 2)
    assert (await channel.status()).counters.held == 1
    await consume(channel, BOB)
    await consume(channel, ANN, 3)
    assert (await channel.get()).payloads == [b"2"], "the newest item stays"
