"""The multicast of one channel, without a network: the test takes the datagrams from the group."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest

from stampede_rt.errors import ChannelNotFound
from stampede_rt.multicast.encryption import DatagramOpener, RejectReason
from stampede_rt.multicast.layout import MessageKind, MessagePart
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.multicast import channel_multicast
from stampede_rt_channel_host.channels.multicast.multicasts import Multicasts
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.cluster.records import recorded_channel

NOW = 1_700_000_000_000_000_000


class Group:
    address = "239.1.2.3:7000"

    def __init__(self) -> None:
        self.sent = list[bytes]()
        self.wakeup, self.may_send = asyncio.Event(), asyncio.Event()
        self.may_send.set()

    async def send(self, parts: Sequence[bytes], encrypt: Callable[[bytes], bytes]) -> None:
        for at, part in enumerate(parts):
            if at:
                await self.between_parts()
            self.sent.append(encrypt(part))
        self.wakeup.set()
        await self.may_send.wait()

    async def between_parts(self) -> None:
        """Stands for the wait between two parts at a low rate."""

    def close(self) -> None:
        pass

    async def parts(self, opener: DatagramOpener, count: int) -> list[MessagePart]:
        async with asyncio.timeout(30):
            while True:
                found = [opened for one in self.sent if isinstance(opened := opener.open(one), MessagePart)]
                if len(found) >= count:
                    return found
                self.wakeup.clear()
                await self.wakeup.wait()


class Rig:
    def __init__(self) -> None:
        record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(Policy(max_items=4)))
        scheduler = PieceScheduler()
        self.hosted = HostedChannel(recorded_channel(record), MemoryBudget(2**30), lambda: NOW, begin=scheduler.begin)
        self.group = Group()
        self.multicasts = Multicasts(cast(Any, self.group), lambda: NOW)

    def put(self, payload: bytes, attributes: dict[str, str] | None = None) -> None:
        run = IncomingRun(
            encode_run([payload], times=None, attributes=attributes), producer_id=0, first_number=0, wait_nanos=None
        )
        self.hosted.puts.put(run, NOW)

    @asynccontextmanager
    async def reader(self) -> AsyncIterator[DatagramOpener]:
        with self.multicasts.reading(self.hosted) as one:
            await asyncio.sleep(0)  # the task of a first reader begins
            offer = one.offer
            yield DatagramOpener(offer.stream_id, offer.key_number, offer.key)


async def test_items_are_sent_once_for_all_readers_and_a_beat_follows_them() -> None:
    rig = Rig()
    async with rig.reader() as opener, rig.reader():
        rig.put(b"one")
        part, beat = (await rig.group.parts(opener, 2))[:2]
        assert (part.kind, part.first_seq, part.end_seq) == (MessageKind.ITEMS, 1, 2)
        assert (beat.kind, beat.first_seq) == (MessageKind.BEAT, 2)
        assert rig.multicasts.readers == 2


async def test_a_multicast_sends_items_only_while_it_has_readers() -> None:
    rig = Rig()
    rig.put(b"before")
    async with rig.reader() as opener:
        rig.put(b"meanwhile")
        assert (await rig.group.parts(opener, 1))[0].first_seq == 2
    sent = len(rig.group.sent)
    rig.put(b"after")
    await asyncio.sleep(0)
    assert (len(rig.group.sent), len(rig.multicasts), rig.hosted.group_observers) == (sent, 0, {})


async def test_the_key_changes_after_a_reader_has_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(channel_multicast, "KEY_SECONDS_MIN", 0.0)
    rig = Rig()
    async with rig.reader() as staying:
        async with rig.reader() as left:
            pass
        rig.put(b"secret")
        one = rig.multicasts.find(rig.hosted)
        assert one is not None
        async with asyncio.timeout(30):
            while one.offer.key_number == left.key_number:
                rig.put(b"secret")
                await asyncio.sleep(0)
        offer = one.offer
        new = DatagramOpener(offer.stream_id, offer.key_number, offer.key)
        rig.put(b"more secret")
        await rig.group.parts(new, 1)
        later = [datagram for datagram in rig.group.sent if isinstance(new.open(datagram), MessagePart)]
        assert {left.open(datagram) for datagram in later} == {RejectReason.OTHER_KEY}
        assert {staying.open(datagram) for datagram in later} == {RejectReason.OTHER_KEY}


async def test_the_key_can_change_within_a_long_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, at a rate of 1 KB/s a reader that had left could open datagrams for minutes."""
    monkeypatch.setattr(channel_multicast, "KEY_SECONDS_MIN", 0.0)
    rig = Rig()
    one = rig.multicasts._begin(rig.hosted)
    await asyncio.sleep(0)
    offer = one.offer
    former = DatagramOpener(offer.stream_id, offer.key_number, offer.key)

    async def leave() -> None:
        one.join()
        one.leave()

    monkeypatch.setattr(rig.group, "between_parts", leave)
    rig.put(bytes(5000))
    async with asyncio.timeout(30):
        await rig.group.wakeup.wait()
    rig.multicasts.close()
    opened = [former.open(datagram) for datagram in rig.group.sent]
    assert isinstance(opened[0], MessagePart)
    assert set(opened[1:]) == {RejectReason.OTHER_KEY}


async def test_a_reader_after_a_defect_begins_another_multicast(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """In an earlier version, the host offered the dead stream to later readers. They got nothing for 3.5 s."""
    rig = Rig()
    async with rig.reader() as first:
        one = rig.multicasts.find(rig.hosted)
        assert one is not None
        with monkeypatch.context() as broken:
            broken.setattr(rig.group, "send", None)
            rig.put(b"one")
            async with asyncio.timeout(30):
                while not one.has_ended:  # noqa: ASYNC110
                    await asyncio.sleep(0)
        async with rig.reader() as second:
            rig.put(b"two")
            assert (await rig.group.parts(second, 1))[0].first_seq == 2
            assert await rig.group.parts(first, 0) == []
    assert [record.event for record in caplog.records] == ["multicast_failed"]  # type: ignore[attr-defined]


async def test_an_item_that_no_datagram_carries_does_not_count_as_delivered() -> None:
    rig = Rig()
    async with rig.reader() as opener:
        rig.put(bytes(2**20 + 1))
        await rig.group.parts(opener, 1)
        assert (rig.hosted.delivered_items, rig.hosted.delivered_bytes) == (0, 0)
        rig.put(b"one")
        while (await rig.group.parts(opener, 2))[-1].kind is not MessageKind.ITEMS:
            rig.group.sent.clear()
        assert (rig.hosted.delivered_items, rig.hosted.delivered_bytes) == (1, 3)


async def test_readers_learn_that_the_host_no_longer_serves_the_channel() -> None:
    rig = Rig()
    async with rig.reader() as opener:
        rig.put(b"one")
        await rig.group.parts(opener, 1)
        for _ in rig.hosted.ending(ChannelNotFound("deleted")):
            pass
        found = await rig.group.parts(opener, 1)
        while found[-1].kind is not MessageKind.END:
            found = await rig.group.parts(opener, len(found) + 1)
        async with rig.reader() as second_reader:  # the host serves the channel again, before the first reader has left
            rig.group.sent.clear()
            rig.put(b"two")
            assert (await rig.group.parts(second_reader, 1))[0].first_seq == 2


async def test_the_end_is_sent_although_the_streams_of_all_readers_end_with_the_channel() -> None:
    rig = Rig()
    async with rig.reader() as opener:
        for _ in rig.hosted.ending(ChannelNotFound("deleted")):
            pass
    assert (await rig.group.parts(opener, 1))[-1].kind is MessageKind.END
    assert len(rig.multicasts) == 0


async def test_an_item_that_is_too_large_is_only_announced() -> None:
    rig = Rig()
    async with rig.reader() as opener:
        rig.put(bytes(2**20 + 1))
        part = (await rig.group.parts(opener, 1))[0]
        assert (part.kind, part.first_seq) == (MessageKind.BEAT, 2)


async def test_short_items_with_long_attributes_go_in_several_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, 64 such items made a message of more than 1 MiB, which the host did not send."""
    monkeypatch.setattr(channel_multicast, "MESSAGE_BYTES_MAX", 2500)
    rig = Rig()
    async with rig.reader() as opener:
        for _ in range(3):
            rig.put(b"x", {"k": "v" * 1000})
        rig.put(b"x", {"k": "v" * 3000})  # this item is too long for a message, so no message has it
        found = await rig.group.parts(opener, 1)
        while found[-1].kind is not MessageKind.BEAT:
            found = await rig.group.parts(opener, len(found) + 1)
        ranges = dict.fromkeys((one.first_seq, one.end_seq) for one in found if one.kind is MessageKind.ITEMS)
        assert [*ranges] == [(1, 3), (3, 4)]


async def test_a_slow_multicast_skips_items_and_announces_them_in_a_heartbeat() -> None:
    rig = Rig()
    async with rig.reader() as opener:
        rig.group.may_send.clear()
        for _ in range(3):
            rig.put(bytes(5000))
        assert (await rig.group.parts(opener, 1))[0].end_seq == 3  # the first two items
        one = rig.multicasts.find(rig.hosted)
        assert one is not None
        one._goal_s -= channel_multicast.LATE_S_MAX
        rig.group.sent.clear()
        rig.group.may_send.set()
        part = (await rig.group.parts(opener, 1))[0]
        assert (part.kind, part.first_seq) == (MessageKind.BEAT, 4)
        rig.group.sent.clear()
        rig.put(b"four")
        found = await rig.group.parts(opener, 1)
        assert (MessageKind.ITEMS, 4) in {(part.kind, part.first_seq) for part in found}


async def test_a_multicast_that_keeps_up_with_a_busy_channel_skips_nothing() -> None:
    rig = Rig()
    async with rig.reader() as opener:
        one = rig.multicasts.find(rig.hosted)
        assert one is not None
        for seq in range(1, 30):
            rig.group.may_send.clear()
            rig.put(b"x")
            await rig.group.parts(opener, seq)
            rig.put(b"x")  # during the sending
            one._goal_s -= channel_multicast.LATE_S_MAX / 2
            rig.group.may_send.set()
            await asyncio.sleep(0)
        found = [one for one in await rig.group.parts(opener, 30) if one.kind is MessageKind.ITEMS]
        assert all(one.end_seq == other.first_seq for one, other in itertools.pairwise(found))
