"""Subscriptions to a channel host, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import channel_pb2, error_pb2, item_pb2, time_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.subscriptions import subscription
from tests.support.channel_host.rig import OpenedChannel, Rig, S, instant, payloads_of, run_of, running_host


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


class Reader:
    """One subscription, from its `opened` on."""

    def __init__(self, call: Any, opened: pb.SubscriptionOpened) -> None:
        self.call = call
        self.opened = opened
        self.seqs: list[int] = []
        self.payloads: list[bytes] = []
        self.gaps: list[pb.SubscriptionGap] = []
        self.progress = pb.SubscriptionProgress()

    @classmethod
    async def of(cls, channel: OpenedChannel, **fields: Any) -> Reader:
        call = channel.subscribe(**fields)
        async with asyncio.timeout(45):
            first = await call.read()
        assert isinstance(first, pb.SubscribeResponse), await call.code()
        assert first.HasField("opened")
        return cls(call, first.opened)

    async def read(self) -> pb.SubscribeResponse:
        async with asyncio.timeout(20):
            response = await self.call.read()
        assert isinstance(response, pb.SubscribeResponse)
        if response.HasField("gap"):
            self.gaps.append(response.gap)
        if response.HasField("progress"):
            self.progress = response.progress
        for delivered in response.runs:
            payloads = payloads_of(delivered.run)
            self.payloads += payloads
            self.seqs += range(delivered.run.first_seq, delivered.run.first_seq + len(payloads))
        return response

    async def read_items(self, count: int) -> list[bytes]:
        while len(self.payloads) < count:
            await self.read()
        return self.payloads


async def error_of(call: Any) -> grpc.aio.AioRpcError:
    """Read the stream to its end, which must be an error."""
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await asyncio.wait_for(_drain(call), 45)
    return caught.value


async def _drain(call: Any) -> None:
    while await call.read() is not grpc.aio.EOF:
        pass


async def test_a_subscription_without_a_start_yields_only_new_items(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(run_of(b"before"))
    reader = await Reader.of(channel)
    assert (reader.opened.incarnation, reader.opened.next_seq) == (channel.incarnation, 2)
    await channel.put(run_of(b"one", b"two"))
    await channel.put(run_of(b"three", number=3))
    assert await reader.read_items(3) == [b"one", b"two", b"three"]
    assert reader.seqs == [2, 3, 4]
    reader.call.cancel()


async def test_a_subscription_with_a_start_yields_held_items_first_in_the_order_of_seqs(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    await channel.put(run_of(b"b", times=[t + 10]), run_of(b"a", times=[t], number=2), run_of(b"c", times=[t + 20]))
    reader = await Reader.of(channel, start=instant(t + 10))
    await channel.put(run_of(b"late", times=[t + 1]))
    assert await reader.read_items(3) == [b"b", b"c", b"late"]
    exclusive = await Reader.of(channel, start=instant(t + 10, exclusive=True))
    assert await exclusive.read_items(1) == [b"c"]
    reader.call.cancel()
    exclusive.call.cancel()


async def test_a_resumed_subscription_continues_after_its_last_item(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(run_of(b"a", b"b", b"c"))
    after = item_pb2.ItemPosition(time_unix_nano=1, seq=1, incarnation=channel.incarnation)
    reader = await Reader.of(channel, after=after)
    assert await reader.read_items(2) == [b"b", b"c"]
    reader.call.cancel()


async def test_the_host_reports_the_end_of_a_late_items_span(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    reader = await Reader.of(channel)
    await channel.put(run_of(b"b", times=[t + 10]), run_of(b"a", times=[t], number=2))
    runs = [delivered async for delivered in _runs(reader, 2)]
    assert runs[1].next_time_unix_nano == t + 10
    reader.call.cancel()


async def _runs(reader: Reader, count: int) -> AsyncIterator[Any]:
    seen = 0
    while seen < count:
        for delivered in (await reader.read()).runs:
            seen += 1
            yield delivered


async def test_a_newest_subscription_never_goes_back_and_counts_skipped_items(rig: Rig) -> None:
    channel = await rig.open()
    t = rig.now() - S
    await channel.put(run_of(b"held", times=[t]))
    reader = await Reader.of(channel, mode=pb.SUBSCRIBE_MODE_NEWEST, start=instant(t))
    assert await reader.read_items(1) == [b"held"]
    await channel.put(run_of(b"a", b"b", b"c", times=[t + 1, t + 2, t + 3]))
    assert await reader.read_items(2) == [b"held", b"c"]
    await channel.put(run_of(b"late", times=[t + 1]), run_of(b"d", times=[t + 4], number=2))
    assert await reader.read_items(3) == [b"held", b"c", b"d"]
    reader.call.cancel()


async def test_a_stream_without_items_has_signs_of_life(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    assert subscription.PROGRESS_SECONDS < 5
    monkeypatch.setattr(subscription, "PROGRESS_SECONDS", 0.02)
    channel = await rig.open()
    await channel.put(run_of(b"x"))
    t = rig.now()
    await rig.channels.Advance(pb.AdvanceRequest(channel_id=channel.channel_id, epoch=channel.epoch, time_unix_nano=t))
    reader = await Reader.of(channel)
    for _ in range(2):
        response = await reader.read()
        assert response.progress.next_seq == 2
        assert response.progress.advance_unix_nano == t
        assert t <= response.progress.host_time_unix_nano <= rig.now()
    reader.call.cancel()


async def test_a_subscription_without_payloads_gets_none(rig: Rig) -> None:
    channel = await rig.open()
    reader = await Reader.of(channel, without_payloads=True)
    await channel.put(run_of(b"four"))
    response = await reader.read()
    assert list(response.runs[0].run.payload_length_bytes) == [4]
    assert response.runs[0].run.payloads == b""
    reader.call.cancel()


async def test_many_readers_get_every_item_once_and_in_order(rig: Rig) -> None:
    channel = await rig.open()
    readers = [await Reader.of(channel) for _ in range(32)]
    assert (await channel.status()).subscriptions == 32
    for n in range(20):
        await channel.put(*(run_of(b"%d" % (5 * n + k), number=5 * n + k + 1) for k in range(5)))
    for reader in readers:
        assert await reader.read_items(100) == [b"%d" % n for n in range(100)]
        assert reader.seqs == list(range(1, 101))
        reader.call.cancel()
    status = await channel.until(lambda status: status.subscriptions == 0)
    assert status.counters.delivered_bytes == 32 * status.counters.accepted_bytes


async def test_a_slow_reader_does_not_delay_others_and_learns_of_its_gap(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscription, "WRITE_SECONDS_MAX", 600.0)  # the puts take long on a busy machine
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=4)))
    slow, quick = await Reader.of(channel), await Reader.of(channel)
    for n in range(200):
        await channel.put(run_of(b"%03d" % n + b"x" * 100_000, number=n + 1))
        await quick.read_items(n + 1)
    assert not quick.gaps
    await channel.put(run_of(b"last"))
    while slow.payloads[-1:] != [b"last"]:
        await slow.read()
    missing = sum(gap.items for gap in slow.gaps)
    assert missing > 100
    assert missing + len(slow.payloads) == 201
    assert {gap.reason for gap in slow.gaps} == {error_pb2.ABSENCE_REASON_COLLECTED}
    assert all(gap.detail for gap in slow.gaps)
    assert slow.progress.dropped == missing
    slow.call.cancel()
    quick.call.cancel()


async def test_the_stream_of_a_reader_that_reads_nothing_ends_with_a_reason(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscription, "WRITE_SECONDS_MAX", 0.2)
    channel = await rig.open()
    reader = await Reader.of(channel)
    for n in range(8):
        await channel.put(run_of(b"x" * 2**20, number=n + 1))
    await channel.until(lambda status: status.subscriptions == 0)
    error = await error_of(reader.call)
    assert error.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
    assert "took nothing" in (error.details() or "")


async def test_a_reader_that_does_not_read_the_end_of_its_stream_delays_no_other_caller(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(subscription, "WRITE_SECONDS_MAX", 0.1)
    channel = await rig.open()
    reader = await Reader.of(channel)
    for n in range(8):
        await channel.put(run_of(b"x" * 2**20, number=n + 1))
    await channel.until(lambda status: status.subscriptions == 0)
    assert (await channel.put(run_of(b"others are served")))[0].first_seq == 9
    await asyncio.wait_for(rig.host.leave(), 45)  # waits for all streams
    assert not caplog.records
    reader.call.cancel()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"epoch": 99}, "epoch"),
        ({"mode": 17}, "SubscribeMode"),
        ({"start": time_pb2.Bound()}, "no anchor"),
        ({"group_id": b"g"}, "no group"),
        ({"after": item_pb2.ItemPosition(time_unix_nano=1, seq=1, incarnation=999)}, "incarnation"),
        ({"after": item_pb2.ItemPosition(time_unix_nano=1)}, "no seq"),
        ({"cursor": pb.SubscriptionCursor(next_seq=1, incarnation=999)}, "incarnation"),
        ({"cursor": pb.SubscriptionCursor(next_seq=1, cut_unix_nano=1)}, "group"),
    ],
)
async def test_an_impossible_subscription_is_refused(rig: Rig, fields: dict[str, Any], words: str) -> None:
    channel = await rig.open()
    error = await error_of(channel.subscribe(**fields))
    assert words in (error.details() or "")


async def test_an_advance_is_reported_immediately_though_there_is_no_item_to_send(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The host sends no message only because time has passed.
    monkeypatch.setattr(subscription, "PROGRESS_SECONDS", 1000.0)
    channel = await rig.open("advancing")
    reader = await Reader.of(channel)
    t = rig.now()
    await channel.put(run_of(b"one", times=[t]))
    await reader.read_items(1)
    await rig.channels.Advance(pb.AdvanceRequest(channel_id=channel.channel_id, epoch=channel.epoch, time_unix_nano=t))
    while not reader.progress.HasField("advance_unix_nano"):
        await reader.read()
    assert reader.progress.advance_unix_nano == t
