"""One channel at its host: the core, the directory's record, its waiting callers and its subscriptions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels.channel_ring import ChannelRing
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.fed_copies import FedCopies
from stampede_rt_channel_host.channels.frames import SharedDeliveries
from stampede_rt_channel_host.channels.gets.waiting_gets import WaitingGets
from stampede_rt_channel_host.channels.limits.memory import Charge, MemoryBudget
from stampede_rt_channel_host.channels.move_under_way import MoveUnderWay
from stampede_rt_channel_host.channels.new_channels import NewCopy, OwnedCore, core_of_replica, new_core, replication_of
from stampede_rt_channel_host.channels.observers import ChannelObserver, Observers
from stampede_rt_channel_host.channels.puts.puts import ChannelPuts
from stampede_rt_channel_host.channels.puts.replicated_puts import send_ahead
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.channels.replication import Replication, ReplicationKind, kind_of, own_again
from stampede_rt_channel_host.channels.time_limits import TimeLimits
from stampede_rt_channel_host.core.channel import (
    CONSUMED_RANGE_BYTES,
    CONSUMER_BYTES,
    ConsumptionResult,
    Counters,
    FedChannel,
    Pieces,
    ReachTracker,
    run_to_end,
)
from stampede_rt_channel_host.core.records import RecordedChannel

SUBSCRIPTIONS_MAX = 4096

_orders = itertools.count()


class HostedChannel:
    """One channel at this host.

    `record` is the latest record from the directory. The core has the incarnation of the record. Requests must name
    `epoch`, the epoch of the record. `epoch` 0: the store must ask the directory before it serves the channel again.
    """

    ring: ChannelRing | None = None
    """The newest part of the channel in shared memory, while a process of this machine reads it."""
    moving: MoveUnderWay | None = None
    """The move of the channel away from this host, or to it, while one is under way."""
    is_inherited = False
    """Whether another object of this host has taken the items over: a copy became the owner, or the reverse."""
    recording: Recording | None = None
    """The recording of a channel with an archive."""
    refused_run_bytes = 0
    """The length of a run that the next ring should take; 0: none. The last ring was too small, or did not suit it."""
    ring_making: object = None  # identifies the ring that a worker thread makes for this channel
    registration = 0
    """The number of the host's last registration when the store took `record` over."""
    fed: FedCopies | None = None
    """The copies that this host feeds; most channels have none."""
    due: int | None  # when the sweep looks at the channel; `Deadlines` sets it, and `order` decides between equal ones
    changes = 0
    """The number of changes of the channel at this host."""
    delivered_items = delivered_bytes = 0
    counted_before: Counters | None = None  # see `OwnedCore`
    replication: Replication | None = None
    """The replicas, if the channel has some and this host owns it."""
    _gets: WaitingGets | None = None

    def __init__(
        self,
        record: RecordedChannel,
        memory: MemoryBudget,
        now: Callable[[], int],
        on_touched: Callable[[HostedChannel], None] = lambda hosted: None,
        may_serve: Callable[[], bool] = lambda: True,
        begin: Callable[[Pieces[None]], None] = run_to_end,
        limits: TimeLimits | None = None,
        deliveries: SharedDeliveries | None = None,
        initial: NewCopy | OwnedCore | None = None,
    ) -> None:
        """Set up the channel of `record`. `initial`: the new copy, or the items with which the owner continues.

        The channel calls `on_touched` at every change. `may_serve` says whether the host has its lease. `begin` does
        long work for which no caller waits (`PieceScheduler.begin`). `limits` bounds the waits of all gets of the host,
        and `deliveries` has the messages that readers of the host share. Raises InvalidArgument if the record's policy
        is not possible.
        """
        self.record = record
        self.epoch: int = record.epoch
        self.copy: CopyState | None = initial.state if isinstance(initial, NewCopy) else None
        # `core` takes puts, consumption and advances; readers see `channel`. Without replicas they are the same.
        self.core = new_core(record, now(), initial)
        if self.copy is None and kind_of(record.policy) is not ReplicationKind.NONE:
            self.replication = replication_of(self.core, now, self._announce, record, initial)
        self.channel = self.core if self.replication is None else self.replication.shown
        self._begin, self._limits, self._charge = begin, limits, memory.charge_for(record.created_by)
        self.puts = ChannelPuts(self.core, self._charge, now, self._accepted, self._touched, may_serve)
        if isinstance(initial, OwnedCore):
            self.puts.retries, self.counted_before = initial.retries, initial.counted_before
        self.subscriptions = Observers(begin)
        self.match_streams = Observers(begin)  # streams of matches for the items of this channel
        # Observers for groups: one for all groups that have the channel, and one for the blocked gets of each group.
        # They are few, so the channel wakes all of them in one step.
        self.group_observers: dict[ChannelObserver, None] = {}
        self.group_gets: dict[object, None] = {}  # blocked gets through groups
        # Streams of cut events, and of matches for another channel's items. An empty dict takes less memory than a set.
        self.group_readers: dict[object, None] = {}
        self.deliveries = deliveries or SharedDeliveries()
        self.order, self.due = next(_orders), None  # set here: Python shares at most 30 attribute names of all channels
        self._on_touched, self._now = on_touched, now
        if self.replication is not None:
            send_ahead(self.puts, self.core, self.replication)
            begin(self.replication.filling())

    @property
    def kind_of_replicas(self) -> ReplicationKind:
        """How the channel has replicas."""
        return ReplicationKind.NONE if self.replication is None else self.replication.kind

    @property
    def is_ready(self) -> bool:
        """Whether the host serves the channel: a new owner waits for the replicas first."""
        return self.replication is None or self.replication.is_ready

    def core_of_owner(self, record: RecordedChannel) -> OwnedCore | None:
        """The channel that this copy becomes with its host as the owner; None if the copy does not know enough."""
        copy = self.channel
        if self.copy is None or not self.copy.is_replica or not isinstance(copy, FedChannel):
            return None
        return core_of_replica(copy, self.record, record, self._now())

    @property
    def gets(self) -> WaitingGets:
        """The blocked gets. Most channels have none, so the first blocked get makes this object."""
        if self._gets is None:
            source = self.channel
            self._gets = WaitingGets(source, ReachTracker(source), self._now, begin=self._begin, limits=self._limits)
        return self._gets

    @property
    def waiting_gets(self) -> int:
        """The number of blocked gets, gets through groups included."""
        return len(self.group_gets) + (0 if self._gets is None else len(self._gets))

    def update(self, record: RecordedChannel) -> None:
        """Take over a newer record of the same incarnation. Raises InvalidArgument for an unusable policy."""
        if (record.epoch, record.spec_version) != (self.epoch, self.record.spec_version):
            self.close_ring()
        if self.moving is not None and record.epoch > self.record.epoch:  # a move to another host has failed
            own_again(self.replication, self.record.epoch, record.epoch)
            self.end_move()
        if record.spec_version != self.record.spec_version:
            now = self._now()
            self.core.configure(record.policy, now)
            if self.replication is not None:
                self.replication.configure(record.policy)
            self.record, self.epoch = record, record.epoch
            self.changed(now)
        self.record, self.epoch = record, record.epoch
        if self.recording is not None:
            self.recording.set_policy(record.policy, record.epoch)
        self._touched()

    def has_same_items(self, record: RecordedChannel) -> bool:
        """Whether the channel of `record` has the items of this one, and not a later incarnation's."""
        return self.record.incarnation == record.incarnation

    def record_with(self, recording: Recording) -> None:
        """From now on record the items that the channel accepts."""
        self.recording, self.puts.check_room = recording, recording.recorder.check_room
        recording.set_policy(self.record.policy, self.record.epoch)
        self._touched()

    def archived(self) -> None:
        """Note that the archive has written items: memory may now collect these, and waiting puts may have room."""
        now = self._now()
        self.collect(now)
        self.puts.changed(now)

    def advance(self, instant: int) -> int:
        """Note a producer's promise that no item before `instant` will come. Returns the latest promised instant.

        Raises InFuture if `instant` is too far ahead of the host's clock.
        """
        now = self._now()
        advanced = self.core.advance(instant, now)
        self.changed(now)
        return advanced

    def consume(
        self, consumer_id: int, seqs: Sequence[int], lease_nanos: int, caller_name: str = ""
    ) -> ConsumptionResult:
        """Consume items for one consumer, and accept the waiting puts for which there is room now.

        Raises InvalidArgument, ChannelFull if all consumer places are taken, and Overloaded if the memory for seqs that
        are consumed out of order is used up, or if the caller has too many places or uses too much of this memory.
        """
        now = self._now()
        self.core.check_consumption(consumer_id, seqs, lease_nanos)
        bytes_max, shares = CONSUMER_BYTES + CONSUMED_RANGE_BYTES * len(seqs), self._charge.consumption_shares
        if not (self._charge.has_room(bytes_max) and shares.has_room(caller_name, bytes_max)):
            new_bytes = self.core.consumption_bytes(consumer_id, seqs)
            shares.check(caller_name, new_bytes)
            if new_bytes:  # consumption frees items: it may use a little more memory than puts (CONSUMPTION_SHARE)
                self._charge.claim(new_bytes - self._charge.spare_bytes)
        consumed = self.core.consume(consumer_id, seqs, now, lease_nanos=lease_nanos, caller_name=caller_name)
        shares.note(caller_name, self.core)
        if self.replication is not None:
            self.replication.accepted(now)
        self.puts.changed(now)  # this also calls `_touched`
        return consumed

    def changed(self, now: int) -> None:
        """Wake the readers and the waiting gets and puts of the channel, after an advance or a change of the policy."""
        self._accepted(now)
        if self.core is not self.channel:
            self._announce(now)
        self.puts.changed(now)

    def make_room(self, wanted_bytes: int) -> None:
        """Check that the host has room for the next part of the feed. Raises Overloaded."""
        self._charge.claim(wanted_bytes)

    def fed_part(self, now: int) -> None:
        """Wake the readers of a copy, after its feed has changed it."""
        self._touched()
        self._announce(now)

    def ending(self, error: StampedeError) -> Pieces[None]:
        """End the waits of the channel's callers and the streams of its readers with `error`, in pieces."""
        self.close_ring()
        if self.replication is not None:
            self.replication.end(error)
        for observer in [*self.group_observers]:  # each call is short: an observer leaves long work to the scheduler
            observer.end(error)
        subscriptions, match_streams = self.subscriptions.ending(error), self.match_streams.ending(error)
        yield from self.puts.ending(error)  # first, so that no waiting put is accepted any more
        yield from subscriptions
        yield from match_streams
        if self._gets is not None:
            yield from self._gets.ending(error)

    def leaving(self, error: StampedeError) -> Pieces[None]:
        """End like `ending`, and then free the items. The host gives the channel up, and stops counting its memory."""
        yield from self.replaced(error)
        yield  # afterwards the interrupted calls do not use the channel any more
        if self.core is not self.channel:
            yield from self.channel.emptying()
        if not self.is_inherited:
            yield from self.core.emptying()

    def replaced(self, error: StampedeError) -> Pieces[None]:
        """End like `ending`, but keep the items for the object that replaces this one. Stops counting their memory."""
        if self.copy is not None:
            self.copy.on_dropped()
        if self.moving is not None:
            self.moving.stop()
        if self.recording is not None:
            self.recording.stop()
        if self.replication is not None:
            self.replication.close()
        self._charge.set(0)
        self._charge = Charge(MemoryBudget(0))
        self._on_touched = _ignore
        yield from self.ending(error)

    def collect(self, now: int) -> bool:
        """Free a bounded number of outdated items. Returns True if others are left: then call again soon."""
        more = self.core.collect(now)
        if self.replication is not None:
            more = self.replication.collect(now) or more
        self._repeat_in_ring()
        self.puts.expire(now)
        self._charge.set(self.footprint_bytes())
        return more

    def next_deadline(self, now: int) -> int | None:
        """The time at which `collect` must run again; None if it need not run before the next change.

        This call also frees a few outdated items.
        """
        due: tuple[int | None, ...] = (self.core.next_deadline(now), self.puts.next_expiry())
        if self.replication is not None:
            due = (*due, self.channel.next_deadline(now))
        self._charge.set(self.footprint_bytes())
        return min((one for one in due if one is not None), default=None)

    def begin_move(self) -> MoveUnderWay:
        """Note that a move of the channel is under way."""
        self.moving = MoveUnderWay(self.record.name, self.puts, self._begin)
        return self.moving

    def end_move(self) -> None:
        """End the move, because this host owns the channel now: perform the waiting calls. Idempotent."""
        moving, self.moving = self.moving, None
        if moving is not None:
            moving.end()

    @property
    def is_fallback(self) -> bool:
        """Whether another host owns the channel, and this host keeps the items in case that host is lost soon."""
        return self.moving is not None and self.moving.redirect_error is not None

    def close_ring(self) -> None:
        """Stop repeating the channel in shared memory. The readers ask the host again. Idempotent."""
        ring, self.ring, self.ring_making = self.ring, None, None
        if ring is not None:
            ring.close()

    def _repeat_in_ring(self) -> None:
        """Show the present state to the readers of the ring. A reader must see each item whose put is acknowledged."""
        if self.ring is not None and not self.ring.follow():
            self.refused_run_bytes = self.ring.refused_bytes
            self.close_ring()

    def count_delivered(self, items: int, payload_bytes: int) -> None:
        """Count the items and the payload bytes of a message that was sent to a reader."""
        self.delivered_items += items
        self.delivered_bytes += payload_bytes

    def footprint_bytes(self) -> int:
        """The bytes kept for the channel: stored items, waiting puts, and the retry window."""
        shown = 0 if self.replication is None else self.replication.footprint_bytes
        return self.core.footprint_bytes + shown + self.puts.footprint_bytes

    def _touched(self) -> None:
        """Report the memory of the channel to the budget, and the change to `on_touched`."""
        self._charge.set(self.footprint_bytes())
        self._on_touched(self)

    def _accepted(self, now: int) -> None:
        """Wake the readers after a change of `core`; if the channel has replicas, as soon as the change is shown."""
        if self.replication is None:
            self._announce(now)
        else:
            self.replication.accepted(now)

    def _announce(self, now: int) -> None:
        self.changes += 1
        if self.recording is not None:
            self.recording.accepted(now)
        self._repeat_in_ring()
        if self._gets is not None and len(self._gets):
            self._gets.changed(now)
        for observer in [*self.group_observers]:
            observer.wake()
        self.match_streams.wake()
        self.subscriptions.wake()


def _ignore(hosted: HostedChannel) -> None:
    """The callback of a channel that has left the host."""
