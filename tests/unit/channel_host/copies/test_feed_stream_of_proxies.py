"""A source sends a proxy each new run in fixed places, in the turn of the event loop after the put."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt.values.policy import parse_policy
from stampede_rt.wire.put_frames import put_head, put_request
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import run_parts
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.copies.copy_feed import GRANTS, CopyFeed
from stampede_rt_channel_host.copies.fed_responses import FedResponse, read_response
from stampede_rt_channel_host.copies.feed_stream import FeedStream
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES, ChannelCore, FedItem
from tests.support.channel_host.held_transport import HeldStream, held_stream
from tests.support.channel_host.rig import Rig, running_host
from tests.unit.channel_host.copies.test_feed_stream import pauses, unlimited_time

__all__ = ["unlimited_time"]

PROXY = b"p" * 16
WINDOW_BYTES = 2**20
CHARGE_BYTES = 1 + ITEM_OVERHEAD_BYTES  # the cost of an item with a payload of one byte


class Source:
    """A channel, the stream of a producer, and the stream that feeds a proxy. Keeps the messages of the feed."""

    def __init__(self, rig: Rig, hosted: HostedChannel, producer: HeldStream) -> None:
        self.rig, self.hosted, self.producer = rig, hosted, producer
        self.feed: HeldStream
        self._number = self._read = 0

    async def open(self, credit_bytes: int = WINDOW_BYTES, **opening: Any) -> list[FedResponse | FedItem]:
        """Begin a feed, and return its first messages."""
        self.feed, self._read = await held_stream(self.rig.sockets, "/stampede_rt.v1.ReplicaService/Feed"), 0
        record = self.hosted.record
        first = pb.FeedOpen(
            **{"takes_items": True, "takes_runs": True} | opening, channel_id=record.channel_id, epoch=record.epoch,
            host_id=PROXY, target="proxy:1",
        )  # fmt: skip
        self.feed.send(pb.FeedRequest(open=first, credit_bytes=credit_bytes, sent_nanos=1).SerializeToString())
        await self.feed.until_written(1)
        return await self.messages()

    def put(self, *payloads: bytes, times: Sequence[int] | None = None) -> None:
        payloads = payloads or (b"x",)
        head = put_head(self.hosted.record.channel_id, self.hosted.epoch, 7)
        self.producer.send(put_request(head, self._number + 1, run_parts(payloads, times=times), 10**9))
        self._number += len(payloads)

    async def messages(self) -> list[FedResponse | FedItem]:
        """The next messages of the feed."""
        await pauses()
        before, self._read = self._read, len(self.feed.written())
        return [read_response(raw) for raw in self.feed.written()[before:]]

    async def after_put(self, *payloads: bytes, times: Sequence[int] | None = None) -> FedResponse | FedItem:
        """Put a run, and return the message with it."""
        self.put(*payloads, times=times)
        [message] = await self.messages()
        return message


@asynccontextmanager
async def fed_proxy(credit_bytes: int = WINDOW_BYTES, **policy: Any) -> AsyncIterator[Source]:
    """Yield a channel whose proxy has the first item."""
    async with running_host() as rig:
        record = rig.directory.add_channel("a", rig.host.identity.host_id, policy_to_spec(parse_policy(**policy)))
        hosted = await rig.host.store.bind_for_feed(record.channel_id, record.epoch)
        producer = await held_stream(rig.sockets, "/stampede_rt.v1.ChannelService/Put")
        source = Source(rig, hosted, producer)
        source.put()
        await pauses()
        assert hosted.core.next_seq == 2
        yield source
        producer.close()
        source.feed.close()


class Proxy:
    """A proxy at another host, which takes the messages of a feed."""

    def __init__(self, rig: Rig, source: Source, window_bytes: int = WINDOW_BYTES) -> None:
        self.state = CopyState(lambda: 0)
        self.feed = CopyFeed(
            rig.host.store, source.hosted.record, self.state, PROXY, "proxy:1", window_bytes=window_bytes
        )
        self.source, self.sent = source, list[Any]()
        self.call: Any = SimpleNamespace(write_now=self.sent.append)

    async def take(self, *messages: FedResponse | FedItem) -> list[bool]:
        """Take messages. Returns which of them it took in the turn in which they came."""
        in_same_turn = []
        for message in messages:
            in_same_turn.append(self.feed._take_in_same_turn(self.call, message))
            if not in_same_turn[-1]:
                await self.feed._take(message)
        return in_same_turn

    @property
    def channel(self) -> Any:
        held = self.feed._held()
        assert held is not None
        return held.channel

    def equals_its_source(self) -> bool:
        mine, its = self.channel, self.source.hosted.channel
        return items_of(mine) == items_of(its) and (mine.next_seq, mine.frontier) == (its.next_seq, its.frontier)


def items_of(core: ChannelCore) -> list[tuple[int, int, int]]:
    """The seq, time and length of each item. A source joins some runs, so a copy may have other runs."""
    held = [(one, at) for one in core.held.slices() for at in range(one.lo, one.hi)]
    return [(one.run.first_seq + at, one.run.times[at], one.run.lengths[at]) for one, at in held]


@asynccontextmanager
async def proxy_of(source: Source, **named: int) -> AsyncIterator[Proxy]:
    """Yield a proxy with all items of `source`, whose feed has just begun."""
    async with running_host() as other:
        proxy = Proxy(other, source, **named)
        await proxy.take(*await source.open())
        assert proxy.state.caught_up
        proxy.sent.clear()
        yield proxy


def is_alone(message: FedResponse | FedItem) -> bool:
    return isinstance(message, FedItem)


async def check_next_run(source: Source, proxy: Proxy) -> None:
    """Check that the next run goes to the proxy alone, and that the proxy then has everything."""
    message = await source.after_put()
    assert is_alone(message)
    await proxy.take(message)
    assert proxy.equals_its_source()


async def test_a_run_goes_to_a_proxy_alone_in_the_turn_after_its_put(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        monkeypatch.setattr(FeedStream, "_next_message", None)  # the task of the feed has nothing to do
        for payloads in ((b"x",), (b"a", b"bc", b""), (b"y",)):
            acks = len(source.producer.written())
            source.put(*payloads)
            assert len(source.producer.written()) == acks + 1, "the producer does not wait for the proxy"
            await asyncio.sleep(0)
            [message] = await source.messages()
            assert isinstance(message, FedItem)
            assert (message.item.items, message.item.length) == (len(payloads), len(b"".join(payloads)))
            assert await proxy.take(message) == [True]
            assert proxy.equals_its_source()
        assert proxy.sent == [], "a proxy does not answer"


async def test_the_runs_of_one_turn_go_to_a_proxy_together() -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        source.put()
        source.put()
        message = await source.after_put()
        assert isinstance(message, FedResponse)
        assert (message.fields.state.first_seq, message.fields.state.next_seq) == (2, 5)
        assert await proxy.take(message, await source.after_put()) == [True, True]
        assert proxy.equals_its_source()


@pytest.mark.parametrize("opening", [{"takes_runs": False}, {"takes_runs": False, "takes_items": False}])
async def test_a_proxy_of_an_older_release_gets_the_general_form(opening: dict[str, bool]) -> None:
    async with fed_proxy() as source:
        await source.open(**opening)
        for _ in range(2):
            assert not is_alone(await source.after_put())


async def test_the_collected_items_leave_the_proxy_with_a_run() -> None:
    async with fed_proxy(max_items=2) as source, proxy_of(source) as proxy:
        alone = []
        for _ in range(5):
            message = await source.after_put()
            alone.append(is_alone(message))
            await proxy.take(message)
            assert proxy.equals_its_source()
        assert alone == [True, False, True, True, True], "the first collection has more facts than the later ones"


async def test_a_late_run_goes_to_a_proxy_alone() -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        newest = source.hosted.core.newest
        assert newest is not None
        message = await source.after_put(times=[newest - 5])
        assert is_alone(message)
        await proxy.take(message)
        assert proxy.equals_its_source()


async def test_other_facts_go_to_a_proxy_in_the_general_form() -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        newest = source.hosted.core.newest
        assert newest is not None
        source.put()
        source.hosted.advance(newest)
        [message] = await source.messages()
        assert isinstance(message, FedResponse)
        assert message.fields.state.advance_unix_nano == newest
        await proxy.take(message)
        source.put()
        source.feed.send(pb.FeedRequest(sent_nanos=2).SerializeToString())
        [sign] = await source.messages()
        assert isinstance(sign, FedResponse)
        assert sign.fields.state.heard_nanos == 2, "the proxy waits for a sign of life"
        await proxy.take(sign)
        await check_next_run(source, proxy)


async def test_a_proxy_without_credit_gets_nothing_and_then_misses_the_collected_items() -> None:
    async with fed_proxy(max_items=2) as source, proxy_of(source) as proxy:
        for _ in range(2):
            await proxy.take(await source.after_put())
        [stream] = [one for one in source.hosted.group_observers if isinstance(one, FeedStream)]
        stream._credit.amount_left = CHARGE_BYTES + 1
        await proxy.take(await source.after_put())
        await proxy.take(await source.after_put())
        assert stream._credit.amount_left == 1 - CHARGE_BYTES, "one message may exceed the credit"
        for _ in range(4):
            source.put()
        await proxy.take(*await source.messages())
        assert (proxy.channel.next_seq, source.hosted.core.next_seq) == (6, 10), "the state needs no credit"
        source.feed.send(pb.FeedRequest(credit_bytes=WINDOW_BYTES, sent_nanos=1).SerializeToString())
        await proxy.take(*await source.messages())
        assert proxy.equals_its_source()
        assert proxy.channel.missed == 2
        await check_next_run(source, proxy)


async def test_a_proxy_whose_socket_is_full_gets_the_runs_later() -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        source.feed.connection.pause_writing()
        source.put()
        source.put()
        await pauses()
        source.put()
        source.feed.connection.resume_writing()
        await proxy.take(*await source.messages())
        assert proxy.equals_its_source()
        await check_next_run(source, proxy)


async def test_a_proxy_continues_after_a_cut() -> None:
    async with fed_proxy(max_items=3) as source, proxy_of(source) as proxy:
        for _ in range(3):
            await proxy.take(await source.after_put())
        source.feed.close()
        source.put()
        place = pb.FeedPlace(incarnation=proxy.channel.incarnation, next_seq=proxy.channel.next_seq)
        opened = await source.open(place=place)
        assert not any(map(is_alone, opened))
        await proxy.take(*opened)
        assert proxy.equals_its_source()
        await check_next_run(source, proxy)


async def test_a_proxy_refuses_a_run_if_it_lacks_earlier_ones() -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        lost, message = await source.after_put(), await source.after_put()
        assert is_alone(lost)
        with pytest.raises(InvalidArgument, match="has the item with seq 3, and the copy is at 2"):
            await proxy.take(message)


async def test_a_proxy_grants_credit_again_after_a_part_of_its_window() -> None:
    async with fed_proxy() as source, proxy_of(source, window_bytes=GRANTS * 3 * CHARGE_BYTES) as proxy:
        proxy.feed._granted, proxy.feed._owes_request = 0, False
        in_same_turn = []
        for _ in range(4):
            in_same_turn += await proxy.take(await source.after_put())
        assert in_same_turn == [True, True, True, False], "the task that reads sends the request"
        assert proxy.feed._owes_request
        assert proxy.feed._next_request().credit_bytes == 4 * CHARGE_BYTES


async def test_a_run_that_comes_alone_completes_a_proxy() -> None:
    async with fed_proxy() as source, proxy_of(source) as proxy:
        message = await source.after_put()
        assert is_alone(message)
        proxy.state.caught_up = False
        assert await proxy.take(message) == [False]
        assert proxy.state.caught_up
        assert proxy.feed._owes_request, "the source may now send readers to it"


async def test_an_error_while_a_run_is_sent_ends_the_feed_and_not_the_put(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fed_proxy() as source:
        await source.open()

        def fail(*_: object) -> bytes:
            raise RuntimeError("no message")

        monkeypatch.setattr("stampede_rt_channel_host.copies.feed_stream.encode_item", fail)
        source.put()
        await pauses()
        assert source.hosted.core.next_seq == 3, "the host has accepted the item"
        assert not source.hosted.group_observers, "the feed is over"


async def test_a_proxy_of_a_proxy_gets_the_general_form() -> None:
    async with fed_proxy() as source, running_host() as other:
        proxy = Proxy(other, source)
        await proxy.take(*await source.open())
        proxy.state.as_of_nanos = proxy.state.steady_nanos()
        middle = Source(other, source.hosted, source.producer)
        assert len(await middle.open()) == 2
        message = await source.after_put()
        assert is_alone(message)
        await proxy.take(message)
        [message] = await middle.messages()
        assert not is_alone(message)
        middle.feed.close()
