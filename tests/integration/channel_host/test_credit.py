"""The credit that readers give a channel host, over raw streams: none, one item, too much, and invalid values."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.subscriptions import subscription
from stampede_rt_channel_host.channels.subscriptions.credit import CREDIT_MAX, Credit
from tests.support.channel_host.rig import OpenedChannel, Rig, S, payloads_of, run_of, running_host


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def begun(channel: OpenedChannel, **fields: Any) -> Any:
    """A subscription that the host has opened, without credit."""
    call = await channel.subscribe_slowly(**fields)
    async with asyncio.timeout(45):
        assert (await call.read()).HasField("opened")
    return call


async def grant(call: Any, credit_bytes: int) -> None:
    await call.write(pb.SubscribeRequest(credit_bytes=credit_bytes))


async def read(call: Any) -> pb.SubscribeResponse:
    async with asyncio.timeout(45):
        response: pb.SubscribeResponse = await call.read()
    return response


def payloads(response: pb.SubscribeResponse) -> list[bytes]:
    return [payload for delivered in response.runs for payload in payloads_of(delivered.run)]


async def test_a_reader_without_credit_gets_nothing_and_costs_no_memory(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscription, "PROGRESS_SECONDS", 0.0)  # a sign of life would be due at any time
    monkeypatch.setattr(subscription, "WRITE_SECONDS_MAX", 0.1)
    channel = await rig.open()
    call = await begun(channel)
    for number in range(50):
        await channel.put(run_of(b"%02d" % number + b"x" * 2**18, number=number + 1))
    status = await channel.status()
    assert (status.counters.delivered_bytes, status.subscriptions) == (0, 1)
    await grant(call, 1)
    assert [payload[:2] for payload in payloads(await read(call))] == [b"00"]  # the first item, and none before it
    call.cancel()


async def test_each_item_costs_its_payload_and_64_bytes_and_the_last_one_may_exceed_the_credit(rig: Rig) -> None:
    channel = await rig.open()
    call = await begun(channel)
    await channel.put(run_of(*(b"%06d" % number for number in range(10))))
    await grant(call, 2 * 70 + 1)
    assert payloads(await read(call)) == [b"000000", b"000001", b"000002"]
    await grant(call, 69)  # the last item exceeded the credit, so nothing comes yet
    await grant(call, 1)
    assert payloads(await read(call)) == [b"000003"]
    call.cancel()


async def test_the_host_chooses_the_newest_item_when_the_credit_arrives_and_counts_skipped_items(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    call = await begun(channel, mode=pb.SUBSCRIBE_MODE_NEWEST)
    for number in range(30):
        await channel.put(run_of(b"%d" % number, number=number + 1, times=[t + number]))
    await grant(call, 1)
    response = await read(call)
    assert (payloads(response), response.progress.skipped) == ([b"29"], 29)
    assert response.cursor.next_seq == response.progress.next_seq == 31
    call.cancel()


async def test_a_reader_with_too_much_credit_gets_everything_in_bounded_messages(rig: Rig) -> None:
    channel = await rig.open()
    call = await begun(channel)
    for _ in range(8):
        await grant(call, 2**64 - 1)
    for number in range(40):
        await channel.put(run_of(b"x" * 2**16, number=number + 1))
    seen = 0
    while seen < 40:
        response = await read(call)
        seen += len(payloads(response))
        assert len(payloads(response)) <= 2**20 // 2**16
    call.cancel()


def test_credit_is_limited_however_much_a_reader_grants() -> None:
    grants: list[None] = []
    credit = Credit(lambda: grants.append(None))
    for _ in range(3):
        credit.grant(2**64 - 1)
    credit.grant(0)
    assert (credit.amount_left, len(grants), credit.is_over) == (CREDIT_MAX, 3, False)
    credit.spend(CREDIT_MAX + 5)
    credit.end()
    assert (credit.amount_left, credit.is_over) == (-5, True)


def test_credit_for_one_response_replaces_the_rest_and_ends_with_the_response() -> None:
    credit = Credit(lambda: None)
    credit.grant(500)
    credit.grant(1000, one_response=True)
    credit.grant(1000, one_response=True)
    assert credit.amount_left == 1000
    credit.spend(0)  # a response without items
    assert credit.amount_left == 1000
    credit.spend(70)
    assert credit.amount_left == 0
    credit.grant(1000, one_response=True)
    credit.grant(10)
    assert credit.amount_left == 10
    credit.grant(10)
    credit.spend(5)
    assert credit.amount_left == 15


async def test_a_response_uses_up_the_credit_that_is_for_one_response(rig: Rig) -> None:
    channel = await rig.open()
    call = await begun(channel)
    for name in (b"a", b"b"):
        await channel.put(run_of(name + b"1", name + b"2"))
        await call.write(pb.SubscribeRequest(credit_bytes=2**20, one_response=True))
        assert payloads(await read(call)) == [name + b"1", name + b"2"]
    await channel.put(run_of(b"c1"))
    await channel.put(run_of(b"c2"))
    await grant(call, 1)
    assert payloads(await read(call)) == [b"c1"]  # with the rest of the credit, both would have come
    call.cancel()


async def test_a_reader_that_half_closes_its_stream_gets_the_items_of_its_credit_and_then_the_end(rig: Rig) -> None:
    channel = await rig.open()
    call = await begun(channel)
    await grant(call, 1)
    await call.done_writing()
    await channel.put(run_of(b"one", b"two"))
    assert payloads(await read(call)) == [b"one"]
    assert await read(call) is grpc.aio.EOF
    assert await call.code() is grpc.StatusCode.OK


@pytest.mark.parametrize(
    ("requests", "expected"),
    [
        ([], "no open"),
        ([pb.SubscribeRequest(credit_bytes=5)], "no open"),
        (["open", "open"], "open already"),
    ],
)
async def test_a_stream_that_does_not_begin_with_open_or_opens_twice_is_refused(
    rig: Rig, requests: list[Any], expected: str
) -> None:
    channel = await rig.open()
    opening = channel.subscribe_request()
    call = rig.channels.Subscribe(iter([opening if one == "open" else one for one in requests]))
    with pytest.raises(grpc.aio.AioRpcError, match=expected):
        async for _ in call:
            pass


async def test_an_advance_is_reported_only_when_everything_before_it_was_sent(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    call = await begun(channel)
    await channel.put(run_of(b"one", b"two", times=[t, t + 1]))
    await rig.channels.Advance(
        pb.AdvanceRequest(channel_id=channel.channel_id, epoch=channel.epoch, time_unix_nano=t + 2)
    )
    await grant(call, 1)
    first = await read(call)
    assert (payloads(first), first.HasField("progress")) == ([b"one"], False)
    await grant(call, 1000)
    assert payloads(await read(call)) == [b"two"]
    assert (await read(call)).progress.advance_unix_nano == t + 2
    call.cancel()
