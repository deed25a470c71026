"""Gets from a channel host, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator
from typing import Any

import pytest

from stampede_rt.v1 import channel_pb2, error_pb2, item_pb2, time_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt_channel_host.core.channel import PendingGet, Pieces, ReadAnswer, WakeAt
from stampede_rt_channel_host.core.channel.pieces import STEPS_PER_PIECE
from stampede_rt_channel_host.core.channel.run import Run
from tests.support.channel_host.rig import (
    FOREVER,
    MAX_INSTANT,
    MIN_INSTANT,
    MS,
    OpenedChannel,
    Rig,
    S,
    between,
    instant,
    run_of,
    running_host,
)  # fmt: skip

FAST_FORWARD = 60 * S


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


class Exchange:
    """One open stream of gets."""

    def __init__(self, rig: Rig) -> None:
        self.call = rig.channels.Get()

    async def send(self, request: pb.GetRequest) -> None:
        await self.call.write(request)

    async def read(self) -> pb.GetResponse:
        async with asyncio.timeout(45):
            response = await self.call.read()
        assert isinstance(response, pb.GetResponse)
        return response


async def filled(rig: Rig) -> tuple[OpenedChannel, int]:
    """A channel with the items a, b and c at t, t + 10 and t + 20 ns, and the time t. The item c lasts 5 ns."""
    channel = await rig.open()
    t = rig.now() - S
    await channel.put(run_of(b"a", b"b", b"c", times=[t, t + 10, t + 20], durations=[-1, -1, 5]))
    return channel, t


async def test_each_match_selects_the_items_of_the_time_model(rig: Rig) -> None:
    channel, t = await filled(rig)

    async def matching(match: time_pb2.Match, start: int, end: int) -> list[bytes]:
        return (await channel.get(interval=between(t + start, t + end, end_exclusive=True), match=match)).payloads

    assert await matching(time_pb2.MATCH_SPAN, 5, 11) == [b"a", b"b"]
    assert await matching(time_pb2.MATCH_UNSPECIFIED, 5, 11) == [b"a", b"b"]
    assert await matching(time_pb2.MATCH_START, 5, 11) == [b"b"]
    assert await matching(time_pb2.MATCH_WHOLE, 5, 21) == [b"b"]
    assert await matching(time_pb2.MATCH_SPAN, 25, 30) == []


async def test_the_answer_names_the_bucket_after_its_last_item(rig: Rig) -> None:
    channel, t = await filled(rig)
    got = await channel.get(interval=between(t, t + 5))
    assert got.payloads == [b"a"]
    assert got.runs[-1].next_time_unix_nano == t + 10
    assert not (await channel.get()).runs[-1].HasField("next_time_unix_nano")


async def test_a_part_of_a_run_keeps_its_seqs(rig: Rig) -> None:
    channel, t = await filled(rig)
    got = await channel.get(interval=between(t + 10, t + 20), match=time_pb2.MATCH_START)
    assert got.payloads == [b"b", b"c"]
    assert [delivered.run.first_seq for delivered in got.runs] == [2]


async def test_a_get_obeys_its_limit_its_direction_and_its_page(rig: Rig) -> None:
    channel, t = await filled(rig)
    first = await channel.get(limit=2)
    assert (first.payloads, first.summary.more) == ([b"a", b"b"], True)
    rest = await channel.get(limit=2, after=item_pb2.ItemPosition(time_unix_nano=t + 10, seq=2))
    assert (rest.payloads, rest.summary.more) == ([b"c"], False)
    assert (await channel.get(limit=1, newest_first=True)).payloads == [b"c"]
    assert (await channel.get(newer_than=item_pb2.ItemPosition(time_unix_nano=t + 10))).payloads == [b"c"]


async def test_reads_without_payloads_keep_the_lengths(rig: Rig) -> None:
    channel, _ = await filled(rig)
    got = await channel.get(without_payloads=True)
    assert list(got.runs[0].run.payload_length_bytes) == [1, 1, 1]
    assert got.runs[0].run.payloads == b""
    assert (await channel.status()).counters.delivered_bytes == 0


async def test_delivered_items_are_counted(rig: Rig) -> None:
    channel, _ = await filled(rig)
    await channel.get()
    assert (await channel.status()).counters.delivered_bytes == 3


async def test_meta_times_are_resolved_and_reported(rig: Rig) -> None:
    channel, t = await filled(rig)
    interval = time_pb2.Interval(
        start=time_pb2.Bound(meta_time=time_pb2.META_TIME_NEWEST, offset_nanos=-10),
        end=time_pb2.Bound(meta_time=time_pb2.META_TIME_NOW),
    )
    got = await channel.get(interval=interval)
    assert got.payloads == [b"b", b"c"]
    assert got.summary.interval.start_unix_nano == t + 10
    assert got.summary.interval.end_unix_nano <= rig.now()


async def test_an_empty_answer_has_a_reason(rig: Rig) -> None:
    channel = await rig.open()
    got = await channel.get()
    assert got.summary.reason == error_pb2.ABSENCE_REASON_NOT_YET
    assert got.summary.detail


async def test_large_answers_come_in_messages_of_about_a_mebibyte(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    for n in range(10):
        await channel.put(run_of(bytes([n]) * 300_000, times=[t + n]))
    got = await channel.get()
    assert [payload[0] for payload in got.payloads] == list(range(10))
    assert len(got.responses) == 4
    assert all(response.ByteSize() <= 2**20 for response in got.responses)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"interval": between(5, 4)}, error_pb2.ERROR_REASON_INVALID_INTERVAL),
        ({"interval": None}, error_pb2.ERROR_REASON_INVALID_ARGUMENT),
        ({"interval": time_pb2.Interval(start=instant(1))}, error_pb2.ERROR_REASON_INVALID_ARGUMENT),
        ({"limit": 0}, error_pb2.ERROR_REASON_INVALID_ARGUMENT),
        ({"match": 17}, error_pb2.ERROR_REASON_INVALID_ARGUMENT),
        ({"wait_nanos": -2}, error_pb2.ERROR_REASON_INVALID_ARGUMENT),
        ({"epoch": 99}, error_pb2.ERROR_REASON_WRONG_EPOCH),
        ({"channel_id": b"x" * 16}, error_pb2.ERROR_REASON_NOT_HERE),
        ({"group_id": b"g"}, error_pb2.ERROR_REASON_GROUP_NOT_FOUND),
        (
            {"after": item_pb2.ItemPosition(time_unix_nano=1, seq=1, incarnation=12345)},
            error_pb2.ERROR_REASON_INCARNATION_LOST,
        ),
    ],
)
async def test_a_refused_call_has_a_reason_and_does_not_end_its_stream(
    rig: Rig, change: dict[str, Any], reason: error_pb2.ErrorReason
) -> None:
    channel, _ = await filled(rig)
    exchange = Exchange(rig)
    request = channel.get_request(1)
    for field, value in change.items():
        request.ClearField(field)
        if isinstance(value, time_pb2.Interval | item_pb2.ItemPosition):
            getattr(request, field).CopyFrom(value)
        elif value is not None:
            setattr(request, field, value)
    await exchange.send(request)
    refused = await exchange.read()
    assert (refused.call_id, refused.error.reason) == (1, reason)
    assert refused.error.message
    await exchange.send(channel.get_request(2))
    assert (await exchange.read()).call_id == 2
    exchange.call.cancel()


async def test_a_blocked_get_is_released_by_the_first_matching_item(rig: Rig) -> None:
    channel = await rig.open()
    exchange = Exchange(rig)
    now = rig.now()
    later = between(now + 10, MAX_INSTANT)
    await exchange.send(channel.get_request(7, interval=later, match=time_pb2.MATCH_START, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    await channel.put(run_of(b"too early", times=[now]))
    assert (await channel.status()).waiting_gets == 1
    await channel.put(run_of(b"it", times=[now + 11]))
    response = await exchange.read()
    assert response.call_id == 7
    assert response.runs[0].run.payloads == b"it"
    assert (await channel.status()).waiting_gets == 0
    exchange.call.cancel()


async def test_a_get_that_searches_in_pieces_searches_again_only_if_the_channel_changes(rig: Rig) -> None:
    retention = channel_pb2.RetentionPolicy(max_age_nanos=3600 * S)  # all items stay for as long as the test takes
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=retention))
    now = rig.now()
    for _ in range(STEPS_PER_PIECE + 1):
        await channel.put(run_of(b"too early", times=[now], durations=[5]))
    hosted = rig.host.store.find(channel.channel_id, channel.epoch)
    polling, searches = hosted.channel.polling, 0

    def counted(pending: PendingGet, clock: int) -> Pieces[ReadAnswer | WakeAt]:
        nonlocal searches
        searches += 1
        pieces = polling(pending, clock)
        next(pieces)
        yield
        if searches == 1:
            hosted.changes += 1
        return (yield from pieces)

    hosted.channel.polling = counted  # type: ignore[method-assign]
    exchange, later = Exchange(rig), between(now + 10, MAX_INSTANT)
    await exchange.send(channel.get_request(7, interval=later, match=time_pb2.MATCH_SPAN, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    assert searches == 2
    await channel.put(run_of(b"it", times=[now + 11]))
    assert (await exchange.read()).runs[0].run.payloads == b"it"
    exchange.call.cancel()


async def test_a_waiting_call_does_not_delay_another_one(rig: Rig) -> None:
    channel = await rig.open()
    exchange = Exchange(rig)
    await exchange.send(channel.newest_request(1, wait_nanos=FOREVER))
    await exchange.send(channel.newest_request(2))
    assert (await exchange.read()).call_id == 2
    await channel.put(run_of(b"x"))
    assert (await exchange.read()).call_id == 1
    exchange.call.cancel()


async def test_a_blocked_get_returns_the_found_items_at_its_timeout(rig: Rig) -> None:
    channel = await rig.open()
    got = await channel.get(wait_nanos=20 * MS)
    assert got.payloads == []
    assert got.summary.reason == error_pb2.ABSENCE_REASON_NOT_YET


async def test_complete_waits_until_the_interval_is_finished(rig: Rig) -> None:
    channel, t = await filled(rig)
    exchange = Exchange(rig)
    interval = between(t, t + 100, end_exclusive=True)
    await exchange.send(channel.get_request(1, interval=interval, complete=True, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    await channel.put(run_of(b"d", times=[t + 30]))
    assert (await channel.status()).waiting_gets == 1
    await rig.channels.Advance(
        pb.AdvanceRequest(channel_id=channel.channel_id, epoch=channel.epoch, time_unix_nano=t + 100)
    )
    response = await exchange.read()
    assert response.summary.complete
    assert sum(len(delivered.run.payload_length_bytes) for delivered in response.runs) == 4
    exchange.call.cancel()


async def test_a_get_of_a_future_instant_is_answered_at_that_instant(rig: Rig) -> None:
    channel, _ = await filled(rig)
    await channel.put(run_of(b"open"))
    soon = rig.now() + 30 * MS
    got = await channel.get(interval=between(soon, soon + S), wait_nanos=FOREVER)
    assert got.payloads == [b"open"]
    assert rig.now() >= soon


async def test_a_get_below_the_frontier_is_answered_immediately_despite_its_timeout(rig: Rig) -> None:
    retention = channel_pb2.RetentionPolicy(max_items=1)
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=retention))
    t = rig.now() - S
    await channel.put(run_of(b"a", b"b", times=[t, t + 10]))
    got = await channel.get(interval=between(t, t + 5), wait_nanos=FOREVER)
    assert got.summary.reason == error_pb2.ABSENCE_REASON_COLLECTED
    assert got.summary.truncated


async def test_a_cancelled_get_gets_no_answer_and_is_not_counted_as_waiting(rig: Rig) -> None:
    channel = await rig.open()
    exchange = Exchange(rig)
    await exchange.send(channel.newest_request(1, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    await exchange.send(pb.GetRequest(call_id=1, cancel=True))
    await channel.until(lambda status: status.waiting_gets == 0)
    await exchange.send(pb.GetRequest(call_id=12345, cancel=True))
    await channel.put(run_of(b"x"))
    await exchange.send(channel.newest_request(2))
    assert (await exchange.read()).call_id == 2
    exchange.call.cancel()


async def test_the_gets_of_a_vanished_reader_are_removed(rig: Rig) -> None:
    channel = await rig.open()
    exchange = Exchange(rig)
    await exchange.send(channel.newest_request(1, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    exchange.call.cancel()
    await channel.until(lambda status: status.waiting_gets == 0)


async def test_a_thousand_blocked_gets_are_released_by_one_item_in_their_order(rig: Rig) -> None:
    channel = await rig.open()
    exchange = Exchange(rig)
    for call_id in range(1, 1001):
        await exchange.send(channel.newest_request(call_id, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1000)
    await channel.put(run_of(b"x"))
    responses = [await exchange.read() for _ in range(1000)]
    assert [response.call_id for response in responses] == list(range(1, 1001))
    assert all(response.runs[0].run.payloads == b"x" for response in responses)
    exchange.call.cancel()


async def test_more_calls_than_a_stream_may_have_are_refused_one_by_one(rig: Rig) -> None:
    channel = await rig.open()
    exchange = Exchange(rig)
    for call_id in range(1, 1026):
        await exchange.send(channel.newest_request(call_id, wait_nanos=FOREVER))
    refused = await exchange.read()
    assert (refused.call_id, refused.error.reason) == (1025, error_pb2.ERROR_REASON_OVERLOADED)
    ping = await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())
    assert (ping.refused_calls, ping.refused_items) == (1, 0)
    await exchange.send(pb.GetRequest(call_id=1, cancel=True))
    await exchange.send(channel.newest_request(2000))
    assert (await exchange.read()).call_id == 2000
    exchange.call.cancel()


async def test_a_call_id_may_be_used_again_after_its_call_is_over(rig: Rig) -> None:
    channel, _ = await filled(rig)
    exchange = Exchange(rig)
    for _ in range(3):
        await exchange.send(channel.newest_request(5))
        assert (await exchange.read()).runs[0].run.payloads == b"c"
    await exchange.send(channel.get_request(6, interval=between(MAX_INSTANT - 1, MAX_INSTANT), wait_nanos=FOREVER))
    await exchange.send(channel.newest_request(6))
    assert (await exchange.read()).error.reason == error_pb2.ERROR_REASON_INVALID_ARGUMENT
    exchange.call.cancel()


async def test_a_large_answer_does_not_delay_a_small_one(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    for n in range(20):
        await channel.put(run_of(b"x" * 2**20, times=[t + n]))
    exchange = Exchange(rig)
    await exchange.send(channel.get_request(1))
    await exchange.send(channel.newest_request(2, without_payloads=True))
    large = 0
    while (response := await exchange.read()).call_id == 1:
        assert not response.HasField("summary")
        large += 1
    assert response.runs[0].run.payload_length_bytes[0] == 2**20
    assert large < 20
    exchange.call.cancel()


async def test_an_advance_never_goes_back_and_makes_earlier_puts_too_old(rig: Rig) -> None:
    channel, t = await filled(rig)
    request = pb.AdvanceRequest(channel_id=channel.channel_id, epoch=channel.epoch, time_unix_nano=t + 500)
    assert (await rig.channels.Advance(request)).advance_unix_nano == t + 500
    request.time_unix_nano = t
    assert (await rig.channels.Advance(request)).advance_unix_nano == t + 500
    (ack,) = await channel.put(run_of(b"late", times=[t + 499]))
    assert ack.rejections[0].error.reason == error_pb2.ERROR_REASON_TOO_OLD
    assert (await channel.status()).advance_unix_nano == t + 500
    with pytest.raises(Exception, match="ahead"):
        await rig.channels.Advance(
            pb.AdvanceRequest(channel_id=channel.channel_id, epoch=channel.epoch, time_unix_nano=MAX_INSTANT)
        )


async def test_consume_is_refused_for_channels_without_consumers(rig: Rig) -> None:
    channel, _ = await filled(rig)
    with pytest.raises(Exception, match="counts no consumption"):
        await rig.channels.Consume(pb.ConsumeRequest(channel_id=channel.channel_id, epoch=channel.epoch, seqs=[1]))


async def test_the_status_counts_the_items_and_bytes_of_a_channel(rig: Rig) -> None:
    channel, t = await filled(rig)
    status = await channel.status()
    assert (status.oldest_unix_nano, status.newest_unix_nano) == (t, t + 20)
    assert status.counters.accepted == status.counters.held == 3
    assert status.counters.accepted_bytes == status.counters.held_bytes == 3
    assert status.record.channel_id == channel.channel_id
    assert not status.HasField("advance_unix_nano")
    assert MIN_INSTANT < status.host_time_unix_nano <= rig.now()


async def test_unread_answers_keep_a_bounded_amount_of_collected_items(rig: Rig) -> None:
    """200 gets wait, each for its own item of 1 MiB, and the reader reads no answer. The channel holds one item.

    In an earlier version, the host kept all 200 answers in memory.
    """
    spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=1))
    channel = await rig.open(spec=spec)
    call = rig.channels.Get()
    start = rig.now()
    for place in range(200):
        at = between(start + place, start + place)
        await call.write(channel.get_request(place + 1, interval=at, match=time_pb2.MATCH_START, wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == 200)
    for place in range(200):
        await channel.put(run_of(b"x" * 2**20, times=[start + place]))
    gc.collect()
    kept = [one for one in gc.get_objects() if isinstance(one, Run) and len(one.body) > 2**20]
    assert len(kept) <= 16
    del kept
    answered = [await call.read() for _ in range(200)]
    assert sorted(one.call_id for one in answered) == list(range(1, 201)), "each call has one answer"
    with_items = [one for one in answered if one.runs]
    assert 1 <= len(with_items) <= 16
    gone = {one.summary.reason for one in answered if not one.runs}
    assert gone == {error_pb2.ABSENCE_REASON_COLLECTED}
    call.cancel()
