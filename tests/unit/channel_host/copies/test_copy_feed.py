"""The requests of a copy to its source. A replica reports progress immediately. A silent feed costs few messages."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.copies.copy_feed import BROKEN_AFTER_SECONDS, GRANTS, WINDOW_BYTES, CopyFeed
from stampede_rt_channel_host.copies.fed_responses import read_response
from tests.support.clock import ManualClock
from tests.support.virtual_time import VirtualClock, run_virtually

MS = 10**6


class Rig:
    """The feed of a replica that holds all items before `held.channel.next_seq`, or has no copy yet."""

    def __init__(self, *, holds_items: bool = True) -> None:
        self.clock = ManualClock()
        held = SimpleNamespace(channel=SimpleNamespace(next_seq=5), subscriptions=[])
        self.held: Any = held if holds_items else None
        copies = SimpleNamespace(of=lambda channel_id: self.held)
        store: Any = SimpleNamespace(copies=copies, now=lambda: 0, lease_held=lambda: True)
        record: Any = SimpleNamespace(channel_id=b"c" * 16, name="c")
        state = CopyState(steady_nanos=lambda: self.clock.boot_nanos)
        self.feed = CopyFeed(store, record, state, b"h" * 16, "localhost:1", owner_facts=True)
        self.feed.is_opened = True
        self.feed._request()

    def grants_credit(self, charge_bytes: int = 0) -> bool:
        """Take a message of the source. Returns whether the copy sends a request now."""
        self.feed._owes_request = False
        self.feed._note(pb.FeedState(source_next_seq=self.held.channel.next_seq), charge_bytes)
        return self.feed._owes_request


def test_a_replica_reports_new_items_immediately_and_a_sign_of_life_needs_no_report() -> None:
    rig = Rig()
    rig.grants_credit()  # the copy has caught up
    assert not rig.grants_credit()
    rig.held.channel.next_seq = 6
    assert rig.grants_credit(charge_bytes=64)
    assert rig.feed._request().held_next_seq == 6
    assert not rig.grants_credit()


def test_reports_soon_after_each_other_have_the_same_clock_reading() -> None:
    rig = Rig()
    first = rig.feed._request().sent_nanos
    rig.clock.boot_nanos += 50 * MS
    assert rig.feed._request().sent_nanos == first
    rig.clock.boot_nanos += 50 * MS
    second = rig.feed._request().sent_nanos
    assert second == first + 100 * MS
    rig.clock.boot_nanos += MS
    assert rig.grants_credit(charge_bytes=WINDOW_BYTES // GRANTS)
    assert rig.feed._request().sent_nanos == second + MS


@pytest.mark.parametrize("opened", [None, pb.FeedOpened(begins_anew=True)], ids=["a newer record", "a new copy"])
async def test_a_source_can_change_only_its_own_channel_at_the_copys_host(opened: pb.FeedOpened | None) -> None:
    """Otherwise the copy would take the place of the other channel, even if this host owns that channel."""
    rig = Rig()
    other = pb.FeedResponse(opened=opened, state=pb.FeedState())
    other.state.channel.channel_id = b"x" * 16
    with pytest.raises(InvalidArgument, match="sent the record of another channel"):
        await rig.feed._take(read_response(other.SerializeToString()))


class SlowSource:
    """A source to which the connection takes `connect_s`. Its first answer takes `answer_s`, and then its stream
    ends.
    """

    def __init__(self, connect_s: float, answer_s: float) -> None:
        self._connect_s, self._answer_s = connect_s, answer_s

    def stream_stream(self, method: str, **named: Any) -> Any:
        return lambda: self

    async def write(self, request: pb.FeedRequest) -> None:
        await asyncio.sleep(self._connect_s)
        self._connect_s = 0.0

    async def read(self) -> object:
        await asyncio.sleep(self._answer_s)
        return object()

    def cancel(self) -> None:
        pass


def test_a_source_has_the_whole_time_for_its_answer_after_a_slow_connection() -> None:
    source: Any = SimpleNamespace(host_id=b"s" * 16, target="localhost:1", epoch=1)

    async def feed(_clock: VirtualClock) -> None:
        channel: Any = SlowSource(0.8 * BROKEN_AFTER_SECONDS, 0.6 * BROKEN_AFTER_SECONDS)
        await Rig(holds_items=False).feed.run(source, channel)

    with pytest.raises(Unavailable, match="has ended the feed"):
        run_virtually(feed, seed=1)


class DamagedSource:
    """A source whose first message has these bytes."""

    def __init__(self, raw: bytes) -> None:
        self._raw = raw

    def stream_stream(self, method: str, *, response_deserializer: Any, **named: Any) -> Any:
        self._decode = response_deserializer
        return lambda: self

    async def write(self, request: pb.FeedRequest) -> None:
        pass

    async def read(self) -> object:
        return self._decode(self._raw)

    def cancel(self) -> None:
        pass


@pytest.mark.parametrize("raw", [b"*\x05", b"\xff"], ids=["an item that ends early", "no message"])
async def test_damaged_bytes_end_the_feed_with_an_error_after_which_the_keeper_tries_again(raw: bytes) -> None:
    """In an earlier version, the task of the keeper ended, and nothing fed the copy any more."""
    source: Any = SimpleNamespace(host_id=b"s" * 16, target="localhost:1", epoch=1)
    channel: Any = DamagedSource(raw)
    with pytest.raises(InvalidArgument, match="localhost:1 sent bytes that are no FeedResponse"):
        await Rig(holds_items=False).feed.run(source, channel)


class BreakingSource:
    """A source whose stream breaks for the side that writes, when `break_now` is called."""

    def __init__(self) -> None:
        self._broken = asyncio.Event()
        self.break_now = self._broken.set
        self.writes = 0

    def stream_stream(self, method: str, **named: Any) -> Any:
        return lambda: self

    async def write(self, request: pb.FeedRequest) -> None:
        self.writes += 1
        if self.writes > 1:
            await self._broken.wait()
            raise asyncio.InvalidStateError("the call has ended")

    async def read(self) -> object:
        return await asyncio.get_running_loop().create_future()

    def cancel(self) -> None:
        pass


async def test_a_feed_that_is_stopped_in_the_turn_in_which_its_stream_breaks_ends_as_cancelled() -> None:
    """Otherwise the keeper would take the error for a broken stream, and would feed a copy that it has stopped."""
    source: Any = SimpleNamespace(host_id=b"s" * 16, target="localhost:1", epoch=1)
    rig, broken = Rig(holds_items=False), BreakingSource()
    rig.feed._requests.wake()
    channel: Any = broken
    task = asyncio.create_task(rig.feed.run(source, channel))
    while broken.writes < 2:  # noqa: ASYNC110 - turns of the loop
        await asyncio.sleep(0)
    broken.break_now()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
