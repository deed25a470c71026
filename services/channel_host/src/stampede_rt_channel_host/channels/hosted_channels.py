"""One channel at its host: the core, the directory's record, and whoever waits for it or listens to it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

from stampede_rt.errors import StampedeError
from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.channels.frames import SharedMessages
from stampede_rt_channel_host.channels.memory import Charge, MemoryBudget
from stampede_rt_channel_host.channels.observers import ChannelObserver, Observers
from stampede_rt_channel_host.channels.puts import ChannelPuts
from stampede_rt_channel_host.channels.time_limits import TimeLimits
from stampede_rt_channel_host.channels.waiting_gets import WaitingGets
from stampede_rt_channel_host.core.channel import ChannelCore, Coming, Consumed, Pieces, run_to_end
from stampede_rt_channel_host.core.records import RecordedChannel

SUBSCRIPTIONS_MAX = 4096
_orders = itertools.count()


class HostedChannel:
    """`record` is the directory's, as last told; its epoch fences, its incarnation is the core's."""

    def __init__(
        self,
        record: RecordedChannel,
        memory: MemoryBudget,
        now: Callable[[], int],
        on_touched: Callable[[HostedChannel], None] = lambda hosted: None,
        may_serve: Callable[[], bool] = lambda: True,
        begin: Callable[[Pieces[None]], None] = run_to_end,
        limits: TimeLimits | None = None,
    ) -> None:
        """`on_touched` hears of every change; `may_serve` says whether the host has its lease; `begin` does long work
        that nobody waits for (`PieceScheduler.begin`); `limits` are those of all gets of the host.

        Raises InvalidArgument if the record's policy cannot hold.
        """
        self.record = record
        self.epoch: int = record.epoch
        self.channel = ChannelCore(
            record.policy,
            incarnation=record.incarnation,
            name=record.name,
            lost_before=now() if record.epoch > 1 else None,  # it had an owner before, which took nothing along
            cut=slice_run,
        )
        self.gets = WaitingGets(self.channel, Coming(self.channel), now, begin=begin, limits=limits)
        self.puts = ChannelPuts(self.channel, memory, now, self._announce, self._touched, may_serve)
        self.listeners = Observers(begin)  # subscriptions
        self.matches = Observers(begin)  # subscriptions to matches of its items
        self.followers: dict[ChannelObserver, None] = {}  # groups: they look at each change before another one comes
        self.group_gets: set[object] = set()  # blocked gets through groups
        self.group_readers: set[object] = set()  # cut events and matches that take its items
        self.messages = SharedMessages()
        self.delivered_bytes = 0
        self.due: int | None = None  # when the sweep looks at it; it belongs to `Deadlines`
        self.order = next(_orders)
        self._charge = Charge(memory)
        self._on_touched = on_touched
        self._now = now
        self.changes = 0
        """So many times the channel has changed since it is here."""

    def update(self, record: RecordedChannel) -> None:
        """The directory has a newer record of the same incarnation. Raises InvalidArgument for an unusable policy."""
        if record.spec_version != self.record.spec_version:
            now = self._now()
            self.channel.configure(record.policy, now)
            self.record, self.epoch = record, record.epoch
            self.changed(now)
        self.record, self.epoch = record, record.epoch
        self._touched()

    def advance(self, instant: int) -> int:
        """Promise that nothing earlier than `instant` will come; gives the highest promise. Raises InFuture."""
        now = self._now()
        advanced = self.channel.advance(instant, now)
        self.changed(now)
        return advanced

    def consume(self, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> Consumed:
        """Use items up for one consumer, and let puts in that waited for room. Raises InvalidArgument, ChannelFull."""
        now = self._now()
        consumed = self.channel.consume(consumer_id, seqs, now, lease_nanos=lease_nanos)
        self.puts.changed(now)  # which tells of the change, too
        return consumed

    def changed(self, now: int) -> None:
        """After an advance or another policy: everybody looks again."""
        self._announce(now)
        self.puts.changed(now)

    def ending(self, error: StampedeError) -> Pieces[None]:
        """End the waits of the channel's callers and the streams of its readers with `error`, in pieces."""
        for follower in [*self.followers]:  # which only take note
            follower.end(error)
        listeners, matches = self.listeners.ending(error), self.matches.ending(error)
        yield from self.puts.ending(error)  # first, so that none of them is taken any more
        yield from listeners
        yield from matches
        yield from self.gets.ending(error)

    def leaving(self, error: StampedeError) -> Pieces[None]:
        """As `ending`, for good: the channel is not held here any more, and its memory counts no longer."""
        self._charge.set(0)
        self._charge = Charge(MemoryBudget(0))
        self._on_touched = _ignore
        yield from self.ending(error)
        yield  # those who were interrupted have let go of it
        yield from self.channel.emptying()

    def collect(self, now: int) -> bool:
        """Free what time has outdated, a bounded part; True if more is left to do at once."""
        more = self.channel.collect(now)
        self.puts.expire(now)
        self._charge.set(self.footprint_bytes())
        return more

    def next_deadline(self, now: int) -> int | None:
        """When `collect` is next useful; None: not before something changes. Frees a little, too."""
        due = (self.channel.next_deadline(now), self.puts.next_expiry())
        self._charge.set(self.footprint_bytes())
        return min((one for one in due if one is not None), default=None)

    def count_delivered(self, payload_bytes: int) -> None:
        """A message with so many payload bytes was sent to a reader."""
        self.delivered_bytes += payload_bytes

    def footprint_bytes(self) -> int:
        """The memory kept for the channel: items as they are stored, puts that wait, and the facts about producers."""
        return self.channel.footprint_bytes + self.puts.footprint_bytes

    def _touched(self) -> None:
        """Something was put, consumed or set up."""
        self._charge.set(self.footprint_bytes())
        self._on_touched(self)

    def _announce(self, now: int) -> None:
        self.changes += 1
        if len(self.gets):
            self.gets.changed(now)
        for follower in [*self.followers]:
            follower.wake()
        self.matches.wake()
        self.listeners.wake()


def _ignore(hosted: HostedChannel) -> None:
    """Nobody wants to know any more."""
