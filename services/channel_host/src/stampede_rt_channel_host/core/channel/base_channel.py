"""The parts of one channel, its clock, its counts and its memory. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from stampede_rt.ring.layout import ABSENT_INSTANT
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.acceptance import Acceptance
from stampede_rt_channel_host.core.channel.acceptances import Acceptances
from stampede_rt_channel_host.core.channel.archive_backlog import ArchiveBacklog
from stampede_rt_channel_host.core.channel.channel_snapshot import ChannelSnapshot
from stampede_rt_channel_host.core.channel.consumption import Consumers
from stampede_rt_channel_host.core.channel.former_incarnations import Losses
from stampede_rt_channel_host.core.channel.held_items import COUNT, Cut
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.limits import BLOCK, ChannelLimits
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.reading import QueryReader
from stampede_rt_channel_host.core.channel.restoring import leave_to_archive, restore
from stampede_rt_channel_host.core.channel.retention import Retention
from stampede_rt_channel_host.core.channel.run import Run, Slice
from stampede_rt_channel_host.core.channel.values import Counters, GrowingCounts, OtherCounts
from stampede_rt_channel_host.core.ring_writer import RingFacts

FREED_ENTRIES_PER_CALL = 32
"""The most index entries of outdated items that one put or read frees in addition to its own work."""


class BaseChannel:
    """The parts of one channel. Each call first outdates the items that are too old."""

    acceptances: Acceptances | None = None
    """The instants of acceptance of the items, if the channel is recorded."""

    def __init__(
        self,
        policy: Policy,
        *,
        incarnation: int,
        name: str = "",
        lost_before: int | None = None,
        cut: Cut | None = None,
        held: Holdings | None = None,
    ) -> None:
        """Make an empty channel, or one that takes over the items `held`.

        Raises InvalidArgument if the policy is not possible (see `ChannelLimits.of`).

        `lost_before` is the instant at which this incarnation began, if an earlier incarnation was lost with its host.
        Readers of earlier times get the reason LOST. `cut` copies the body of some items out of a run's body. Without
        `cut` the channel keeps the whole body of a run until all items of the run are freed.
        """
        self._policy = policy
        self._incarnation = incarnation
        self.lost_before = lost_before
        self._held = Holdings(cut) if held is None else held
        self._retention = Retention(ChannelLimits.of(policy), self._held)
        self.name = name
        self._acceptance = Acceptance(self._held, self._retention, name)
        self._reading = QueryReader(self._held, self._retention, incarnation, lost_before)
        self._clock: int | None = None  # the latest `now` of a call
        self._puts_since_aging = 0  # puts since `_age_and_free` last applied the age limit
        self._aged_at: int | None = None  # the clock to which `_age_and_free` last applied the age limit
        self._entries_to_free = 0  # entries that puts may have added since they last freed memory

    def collect(self, now: int, entries_max: int = 64) -> bool:
        """Free about `entries_max` index entries of outdated items. Returns True if more work is left.

        Puts and reads also free a few entries.
        """
        self._age_and_free(self._tick(now))
        has_more_reports = self._retention.report_collected(entries_max // 2)  # half as many: a report takes longer
        self._retention.continue_owed_check()
        return self._held.free(entries_max) or has_more_reports or self._retention.has_more

    def emptying(self) -> Pieces[None]:
        """Free all items, in pieces. The channel must not be used afterwards."""
        self._held.report_gone_to(None)
        self._held.outdate(self._held.oldest_by_count(self._held.items), COUNT, self._clock or 0)
        yield
        while self._held.free(pieces.STEPS_PER_PIECE // 2):
            yield

    def next_deadline(self, now: int) -> int | None:
        """The time at which `collect` next has work, or None if it has none until another call changes the channel.

        If memory is left to free, this is `now`. Otherwise items grow too old at this time, or a consumer's lease ends.
        """
        clock = self._age_and_free(self._tick(now))
        due = self._retention.next_due()
        return clock if self._held.has_backlog or self._retention.has_more else due

    def counters(self, now: int) -> Counters:
        """The present numbers of accepted, held, collected and refused items."""
        self._age_and_free(self._tick(now))
        return self.latest_counters()

    def latest_counters(self) -> Counters:
        """Like `counters`, but as of the last call that took the time. Changes nothing."""
        held = self._held
        return Counters(
            accepted=held.accepted,
            held=held.items,
            collected=dict(held.collected),
            rejected=self._acceptance.rejected,
            accepted_bytes=held.accepted_bytes,
            held_bytes=held.payload_bytes,
            late=held.late,
        )

    @property
    def growth(self) -> GrowingCounts:
        """The counts of accepted items, as of the last call."""
        return GrowingCounts(self._held.accepted, self._held.accepted_bytes)

    @property
    def other_counts(self) -> OtherCounts:
        """The counts that a copy cannot compute from the items alone, as of the last call."""
        held = self._held
        others = sum(held.collected.values()) - held.collected.get(held.last_cause, 0)
        return OtherCounts(self._acceptance.refused_items, held.late, held.last_cause, others)

    @property
    def known_consumers(self) -> Consumers | None:
        """The consumers, if the channel counts consumption. The caller must only read them."""
        return self._retention.consumers

    def look(self, now: int) -> tuple[Holdings, Retention]:
        """The items that are not too old at `now`, and their retention. The caller must only read them."""
        self._age_and_free(self._tick(now))
        return self._held, self._retention

    @property
    def held(self) -> Holdings:
        """The items, as of the last call. The caller must only read them."""
        return self._held

    def snapshot(self, now: int) -> ChannelSnapshot:
        """The channel's present state, for later reads.

        Close the snapshot soon: before that, the channel frees no item that the snapshot shows.
        """
        held, retention = self.look(now)
        snapshot = ChannelSnapshot(
            held, retention, self._incarnation, self.lost_before, self.advanced_to, self._tick(now)
        )
        snapshot.lost_from = self._reading.lost_from
        return snapshot

    def ring_facts(self) -> RingFacts:
        """The facts that a ring in shared memory repeats, as of the last call that took `now`."""
        held, reading = self._held, self._reading
        gone = (held.gone_before, self.lost_before)
        passed = (self.advanced_to, reading.consumed_up_to)
        may_be_archived = self._retention.unarchived is not None and held.newest_collected is not None
        return RingFacts(
            next_seq=held.next_seq,
            has_items=held.items > 0 or may_be_archived,
            passed=max((one for one in passed if one is not None), default=None),
            gone_before=max((one for one in gone if one is not None), default=None),
            floor=(max(held.floor[0], ABSENT_INSTANT), held.floor[1]),
            max_age_nanos=self._retention.limits.max_age_nanos,
            has_overlap=held.overlap_nanos > 0,
            is_recorded=self._policy.is_recorded or self._retention.unarchived is not None,
        )

    def accepted_from(self, seq: int) -> Iterator[Slice]:
        """The held items from `seq` on, in the order of acceptance. The items of a slice ascend in time."""
        return self._held.slices_by_seq(seq, self._held.next_seq)

    def newest_slices(self) -> Iterator[Slice]:
        """The held items, the newest slice first."""
        return self._held.slices_down()

    def record(self, archived_to: int, named: int = 0) -> None:
        """Keep items from the seq `archived_to` on until they are archived, unless max_bytes collects them.

        Call it again when the archive has more items. `named`: the number of lost items that the archive names.
        """
        if self._retention.unarchived is None:
            self._retention.unarchived = ArchiveBacklog(self._held, archived_to)
        else:
            self._retention.unarchived.archived(archived_to, named)
        if self._clock is not None:
            self._retention.drop_excess(self._clock)

    @property
    def backlog(self) -> ArchiveBacklog:
        """The items that are not archived. The channel must be recorded."""
        backlog = self._retention.unarchived
        assert backlog is not None, "the channel is recorded"
        return backlog

    def restore(
        self, runs: Iterable[Run], *, after: int | None, next_seq: int,
        loss: tuple[int | None, int | None], advance: int | None = None,
    ) -> None:  # fmt: skip
        """Take the newest items of an archive into an empty channel, as many as the limits allow.

        `runs` have all items later than `after`, in the order of their seqs.
        `next_seq`: the seq of the next accepted item. `loss`: the first instant at which items may be lost (None: any
        instant), and the instant at which the loss ends (None: no item was lost), see `QueryReader`. `advance`: the
        latest advance.
        """
        restore(self._held, runs, after=after, next_seq=next_seq)
        self._retention.drop_excess(self._held.newest or 0)
        self._reading.lost_from, self.lost_before = loss
        self._reading.note_loss(self.lost_before)
        self._acceptance.advance = self._reading.advance = advance

    def leave_to_archive(self, edge: int, loss: tuple[int | None, int | None], now: int) -> bool:
        """Note that the host has found an archive, with the former owners' items up to the time `edge`.

        `loss`: see `restore`.

        Returns False if this host must still archive items up to `edge`: call it again after the next write.
        """
        clock = self._age_and_free(self._tick(now))
        if not leave_to_archive(self._held, edge, self._retention.unarchived, clock):
            return False
        self._reading.lost_from, self.lost_before = loss
        self._reading.note_loss(self.lost_before)
        return True

    @property
    def footprint_bytes(self) -> int:
        """The memory of the items (see `HeldItems.footprint_bytes`), of their instants of acceptance, and of the
        consumer places, as of the last call.
        """
        consumers, accepted = self._retention.consumers, self.acceptances
        places = 0 if consumers is None else consumers.table.footprint_bytes
        return self._held.footprint_bytes + places + (0 if accepted is None else accepted.footprint_bytes)

    @property
    def freed_entries(self) -> int:
        """The number of index entries freed so far, as a measure of the work done."""
        return self._held.freed_entries

    @property
    def losses(self) -> Losses:
        """The items that were lost with former owners."""
        return Losses(self.lost_before, self._reading.lost_from, self._reading.former)

    def take_losses(self, losses: Losses) -> None:
        """Take over the losses of the channel to which these items belong."""
        self.lost_before, self._reading.lost_from, self._reading.former = losses
        self._reading.note_loss(losses.before)

    def holds(self, incarnation: int, seqs: Iterable[int]) -> bool:
        """Whether the seqs of that incarnation are valid in the present one. `incarnation` 0 is not compared."""
        if incarnation in (0, self._incarnation):
            return True
        ends = [one.next_seq for one in self._reading.former if one.incarnation == incarnation]
        return bool(ends) and max(seqs, default=0) < ends[0]

    @property
    def lost_from(self) -> int | None:
        """The earliest instant of items that may have been lost; see `QueryReader`."""
        return self._reading.lost_from

    @property
    def policy(self) -> Policy:
        """The policy as it was stated, without defaults."""
        return self._policy

    @property
    def limits(self) -> ChannelLimits:
        """The limits of the policy, with the defaults."""
        return self._retention.limits

    @property
    def may_block(self) -> bool:
        """Whether a put may have to wait for room."""
        return self._retention.limits.on_full == BLOCK

    @property
    def incarnation(self) -> int:
        """The incarnation of the channel. Seqs are valid only within one incarnation."""
        return self._incarnation

    @property
    def next_seq(self) -> int:
        """The seq that the next accepted item gets."""
        return self._held.next_seq

    @property
    def missed(self) -> int:
        """The number of items that left the source before this copy could get them. 0 if this is no copy."""
        return self._held.missed

    @property
    def newest(self) -> int | None:
        """The newest item's time, as of the last call that took `now`."""
        return self._held.newest

    @property
    def oldest(self) -> int | None:
        """The oldest held item's time, as of the last call that took `now`."""
        self._age()
        return self._held.oldest

    @property
    def frontier(self) -> int | None:
        """The latest span end of items collected for age, count or bytes (see `HeldItems.frontier`)."""
        self._age()
        return self._held.frontier

    @property
    def advanced_to(self) -> int | None:
        """The highest instant of an advance, before which no item will come. None if there was no advance."""
        return self._acceptance.advance

    def _tick(self, now: int) -> int:
        """The host's clock for a call: `now`, or the latest `now` so far if it is later."""
        self._clock = now if self._clock is None else max(self._clock, now)
        return self._clock

    def _age(self) -> None:
        """Apply the age limit as of the last call, unless the last call has already done so."""
        if self._clock is not None and (self._puts_since_aging or self._aged_at != self._clock):
            self._retention.apply_time(self._clock)

    def _age_and_free(self, clock: int) -> int:
        """Outdate the items that are too old, and free a few outdated entries. Returns `clock`."""
        self._outdate(clock)
        self._held.free(FREED_ENTRIES_PER_CALL, trims=False)  # the next put may free the whole entry
        return clock

    def _outdate(self, clock: int) -> None:
        """Outdate the items that are too old or consumed."""
        self._puts_since_aging, self._aged_at = 0, clock
        if self._retention.consumers is None:
            self._retention.age_out(clock)
        else:
            self._retention.apply_time(clock)
            self._reading.consumed_up_to = self._held.newest_consumed
