"""The oracle's groups: cuts, the items that they show, the moments at which items become visible, and matches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.values.timeline import MetaTime, ResolvedInterval
from stampede_rt_channel_host.core.channel import Query
from tests.oracle.channel import Item, OracleChannel
from tests.oracle.pairs import paired
from tests.oracle.reading import OracleReader, _remaining


@dataclass(frozen=True)
class ReportedTimes:
    """The times of a channel, as its owner told them at one moment.

    `end`: the largest time + duration in its newest bucket.
    """

    epoch: int
    incarnation: int
    newest: int | None
    end: int | None
    advance: int | None


@dataclass
class OracleMember:
    """The times of a channel at its owner. The owner looks at them after each put."""

    channel: OracleChannel
    epoch: int
    incarnation: int
    spoke_at: int
    ends: dict[int, int] = field(default_factory=dict)  # by the time of the bucket: the largest end that was seen in it
    _known: tuple[int, int | None] = (0, None)

    def __post_init__(self) -> None:
        self.observe(self.spoke_at)

    def observe(self, clock: int) -> None:
        known = len(self.channel.log), self.channel.advanced_to
        self.spoke_at = self.spoke_at if known == self._known else clock
        self._known = known
        for one in self.channel.held:
            if one.duration is not None:
                self.ends[one.time] = max(one.time + one.duration, self.ends.get(one.time, one.time))

    def report(self) -> ReportedTimes:
        """The present times. Collection takes nothing back: collected items still count."""
        newest = max((one.time for one in self.channel.log.values()), default=None)
        end = None if newest is None else self.ends.get(newest)
        return ReportedTimes(self.epoch, self.incarnation, newest, end, self.channel.advanced_to)


@dataclass
class OracleReports:
    """All reports of the owners of a channel to one host. `known_until` None: this host is the owner."""

    combined_times: ReportedTimes
    silent_since: int
    known_until: int | None
    reports: list[ReportedTimes] = field(default_factory=list)  # all reports of the owners, in order

    @property
    def mark(self) -> int | None:
        """The later of the newest item's time and the advance."""
        times = self.combined_times
        return max((one for one in (times.newest, times.advance) if one is not None), default=None)

    def cut(self, *, by_end: bool, max_lead: int) -> int | None:
        times = self.combined_times
        cuts = [one for one in (times.newest, times.advance) if one is not None]
        if by_end and times.newest is not None and times.end is not None:
            cuts.append(min(times.end, times.newest + max_lead))
        return max(cuts, default=None)


def combined(reports: list[ReportedTimes]) -> ReportedTimes:
    """The times of a channel from all reports about its present incarnation.

    Items of earlier incarnations are lost.
    """
    epoch = max(one.epoch for one in reports)
    life = next(one.incarnation for one in reports if one.epoch == epoch)
    valid = [one for one in reports if one.incarnation == life]
    newest = max((one.newest for one in valid if one.newest is not None), default=None)
    end = max((one.end for one in valid if one.end is not None and one.newest == newest), default=None)
    advance = max((one.advance for one in valid if one.advance is not None), default=None)
    return ReportedTimes(epoch, life, newest, end, advance)


class OracleBoard:
    """All reports of owners to one host, about all channels."""

    def __init__(self) -> None:
        self.received: dict[bytes, OracleReports] = {}

    def own(self, channel_id: bytes, member: OracleMember) -> None:
        self._enter(channel_id, member.report(), member.spoke_at, None)

    def receive(self, channel_id: bytes, owner: OracleReports, clock: int) -> None:
        """Note all times that the owner knows."""
        self._enter(channel_id, owner.combined_times, owner.silent_since, clock)

    def _enter(self, channel_id: bytes, report: ReportedTimes, silent_since: int, known_until: int | None) -> None:
        received = self.received.setdefault(channel_id, OracleReports(report, silent_since, known_until))
        received.silent_since, received.known_until = silent_since, known_until
        if report not in received.reports:
            received.reports.append(report)
            received.combined_times = combined(received.reports)

    def disown(self, channel_id: bytes, clock: int) -> None:
        received = self.received.get(channel_id)
        if received is not None and received.known_until is None:
            received.known_until = clock


@dataclass
class OracleGroup:
    """The cut of a group at one host.

    Call `observe` after each event. Before the cut is confirmed, it shows nothing.
    """

    board: OracleBoard
    members: frozenset[bytes]
    reference: bytes | None
    by_end: bool
    max_lead: int
    idle_after: int | None
    is_confirmed: bool = False
    floor: int | None = None

    @property
    def cut(self) -> int | None:
        return self.floor if self.is_confirmed else None

    def observe(self, clock: int) -> None:
        reached = self.reached(clock)
        if self.is_confirmed and reached is not None:
            self.raise_to(reached)

    def raise_to(self, cut: int) -> None:
        self.floor = cut if self.floor is None else max(self.floor, cut)

    def received(self, channel_id: bytes) -> OracleReports | None:
        return self.board.received.get(channel_id)

    def cut_of(self, channel_id: bytes) -> int | None:
        received = self.received(channel_id)
        return None if received is None else received.cut(by_end=self.by_end, max_lead=self.max_lead)

    def mark_of(self, channel_id: bytes) -> int | None:
        received = self.received(channel_id)
        return None if received is None else received.mark

    def is_idle(self, channel_id: bytes, clock: int) -> bool:
        """Whether the channel was silent for the idle time, as far as the host knows.

        It is not idle before the host has learned of it.
        """
        received = self.received(channel_id)
        if received is None or self.idle_after is None:
            return False
        until = clock if received.known_until is None else received.known_until
        return max(0, until - received.silent_since) >= self.idle_after

    def next_idle(self, clock: int) -> int | None:
        """The instant at which the next of this host's own members becomes idle, and no longer counts.

        None: no own member can become idle.
        """
        if self.idle_after is None or self.reference is not None:
            return None
        awake = [self.received(one) for one in self.members if not self.is_idle(one, clock)]
        own = [one.silent_since for one in awake if one is not None and one.known_until is None]
        return min(own) + self.idle_after if own else None

    def counting(self, clock: int) -> list[bytes]:
        """The members that determine the cut: the reference, or else all members that are not idle. If all are idle:
        the members that became silent last.
        """
        if self.reference is not None:
            return [self.reference]
        awake = [one for one in self.members if not self.is_idle(one, clock)]
        spoke = {one: received.silent_since for one in self.members if (received := self.received(one)) is not None}
        return awake or [one for one in spoke if spoke[one] == max(spoke.values())]

    def reached(self, clock: int) -> int | None:
        cuts = [self.cut_of(one) for one in self.counting(clock)]
        known = [one for one in cuts if one is not None]
        return min(known) if cuts and len(known) == len(cuts) else None

    def waiting_on(self, clock: int) -> list[bytes]:
        """The members of `counting` that hold the cut back."""
        cuts = {one: self.cut_of(one) for one in self.counting(clock)}
        return sorted(one for one, own in cuts.items() if own is None or (self.cut is not None and own <= self.cut))

    def due(self, cut: int, since: int, max_wait: int, lateness: int, clock: int) -> tuple[bool, tuple[bytes, ...]]:
        """Whether an event for a cut that was reached at `since` is due, and which members are behind the cut."""
        behind = tuple(one for one in sorted(self.members) if not self._is_at(one, cut, lateness))
        waits = clock < since + max_wait + lateness and any(not self.is_idle(one, clock) for one in behind)
        return not waits, behind

    def _is_at(self, channel_id: bytes, cut: int, lateness: int) -> bool:
        """Whether no further item can come before the cut, except one that is later than `lateness` allows."""
        received = self.received(channel_id)
        if received is None:
            return False
        newest, advance = received.combined_times.newest, received.combined_times.advance
        return (newest is not None and newest >= cut + lateness) or (advance is not None and advance >= cut)

    def between(self, low: int | None, high: int, lateness: int, clock: int) -> int | None:
        """The latest instant after `low` and before `high` that each member has reached, idle members left out.

        None: there is no such instant.
        """
        awake = [one for one in sorted(self.members) if not self.is_idle(one, clock)]
        tried = [one.combined_times for one in (self.received(each) for each in awake) if one is not None]
        marks = [times.newest - lateness for times in tried if times.newest is not None]
        marks += [times.advance for times in tried if times.advance is not None]
        fit = [mark for mark in marks if mark < high and all(self._is_at(one, mark, lateness) for one in awake)]
        latest = max(fit, default=None)
        return None if latest is None or (low is not None and latest <= low) else latest


class _VisiblePart(OracleChannel):
    """The items before the cut as a channel of their own.

    The collected items are the items that the whole channel has collected.
    """

    def __init__(self, full: OracleChannel, cut: int | None) -> None:
        self.__dict__.update(full.__dict__)
        self.held = [one for one in full.held if cut is not None and one.time < cut]
        self._full = full

    @property
    def frontier(self) -> int | None:
        return self._full.frontier

    @property
    def gone_before(self) -> int | None:
        return self._full.gone_before


class OracleView(OracleReader):
    """Reads through a group. Their clock stops at the cut."""

    def __init__(self, full: OracleChannel, clock: int, cut: int | None) -> None:
        full.age(clock)
        self.full, self.real_clock, self.cut = full, clock, cut
        self.channel = _VisiblePart(full, cut)
        self.clock = clock if cut is None else min(clock, cut)

    @property
    def newest_key(self) -> tuple[int, int] | None:
        """The time and seq of the latest visible item."""
        return max(((one.time, one.seq) for one in self.channel.held), default=None)

    @property
    def window_is_too_short(self) -> bool:
        """Whether an item left before the group showed it, or the channel is ahead of the cut by more than its age
        limit.
        """
        full, cut = self.full, self.cut
        if any(cut is None or time >= cut for time in full.collected_times):
            return True
        return (
            cut is not None
            and full.newest is not None
            and full.max_age is not None
            and (full.newest - cut > full.max_age)
        )

    def wake_at(self, within: ResolvedInterval) -> int | None:
        """The first whole nanosecond of the interval, if it is ahead and a clock that stops at the cut reaches it."""
        first = within.start + 1 if within.start_exclusive else within.start
        ahead = first > self.channel.now(self.clock)
        return first if ahead and self.cut is not None and first <= self.cut else None

    def resolve(self, query: Query) -> ResolvedInterval | None:
        if self.cut is None and MetaTime.NOW in (query.interval.start.meta, query.interval.end.meta):
            return None
        return super().resolve(query)

    def _is_finished(self, region: ResolvedInterval) -> bool:
        """Whether both the whole channel, with hidden items, and the cut have passed the interval."""
        if self.cut is None or not OracleReader(self.full, self.real_clock)._is_finished(region):
            return False
        return self.cut >= region.end if region.end_exclusive else self.cut > region.end

    def hides_an_item_of(self, query: Query, interval: ResolvedInterval) -> bool:
        """Whether a read of the whole channel would give items that the cut hides."""
        reader = OracleReader(self.full, self.real_clock)
        plain = Query(interval=query.interval, match=query.match, newest_first=query.newest_first,
                      after=query.after, newer_than=query.newer_than)  # fmt: skip
        return any(self.cut is None or one.time >= self.cut for one in reader.read(plain, interval).items)

    def reason(self, query: Query, interval: ResolvedInterval | None) -> str | None:
        """Why an answer is empty or partial. The reasons are a channel's, and HIDDEN for items at or past the cut."""
        answer = self.read(query, interval)
        if interval is None:
            return "HIDDEN" if self.full.held else answer.reason
        hides = self.hides_an_item_of(query, interval)
        region = _remaining(query, interval)
        lost_so_far = answer.reason == "LOST" and not answer.items and not self._is_finished(region)
        if answer.reason == "NOT_YET" or lost_so_far:
            passed = OracleReader(self.full, self.real_clock)._is_finished(region)
            return "HIDDEN" if hides or passed else answer.reason
        if answer.items and answer.reason is None and hides and not (answer.more and not query.newest_first):
            return "HIDDEN"
        return answer.reason


@dataclass
class OracleFollower:
    """A reader to which every item becomes visible once.

    `owed`: the seqs that the reader must still get, or whose loss it must still learn.
    """

    channel: OracleChannel
    cut: int | None
    owed: set[int]
    seen_seq: int

    @classmethod
    def begin(cls, channel: OracleChannel, cut: int | None, after_seq: int | None = None) -> OracleFollower:
        """Begin at a cut.

        The reader is owed all items at or past the cut; with `after_seq` also all later seqs, even if gone.
        """
        owed = {one.seq for one in channel.held if cut is None or one.time >= cut}
        return cls(channel, cut, owed, len(channel.log) if after_seq is None else after_seq)

    @property
    def meant(self) -> set[int]:
        """The owed seqs, and the seqs of the items accepted since the last step."""
        return self.owed | set(range(self.seen_seq + 1, len(self.channel.log) + 1))

    def owe(self) -> None:
        """Owe the reader all items accepted up to now."""
        self.owed = self.meant
        self.seen_seq = len(self.channel.log)

    def end_step(self, cut: int, new: list[Item], late: list[Item]) -> set[int]:
        """Check the items that a step to `cut` brought.

        Returns the seqs of the items that were lost since the last step.
        """
        before = self.cut
        assert new == sorted(new)
        assert late == sorted(late)
        assert all(one.time < cut and (before is None or one.time >= before) for one in new)
        assert all(before is not None and one.time < before for one in late)
        seqs = [one.seq for one in new + late]
        assert len(set(seqs)) == len(seqs)
        assert set(seqs) <= self.owed, "the reader gets each item once, and only items that are meant for it"
        self.owed -= set(seqs)
        gone = self.pass_over(cut)
        assert not gone & self.visible(cut), "no item is left out"
        return gone - self.visible(cut)

    def visible(self, cut: int) -> set[int]:
        """The seqs of the items that the group shows at the cut."""
        return {one.seq for one in self.channel.held if one.time < cut}

    def pass_over(self, cut: int) -> set[int]:
        """The owed seqs that the step left out, although their items are visible or gone."""
        held = {one.seq for one in self.channel.held}
        passed = {seq for seq in self.owed if seq not in held} | (self.owed & self.visible(cut))
        self.owed -= passed
        self.cut = cut
        return passed


@dataclass
class OracleMatcher:
    """Matches each item of one channel, in the order of time, with the nearest item of every other member.

    If `last` is not None, no item of another member is in two matches: `last` has the last partner of each member.
    """

    per: OracleChannel
    others: Mapping[bytes, OracleChannel]
    tolerance: int
    position: tuple[int, int]
    lateness: int = 0
    last: dict[bytes, tuple[int, int]] | None = None
    unmatched: int = 0

    def take(self, items_max: int) -> list[tuple[Item, dict[bytes, Item]]]:
        """Return the matches that are decided.

        With `last`, an item that waits for a nearer one counts as decided, too.
        """
        taken: list[tuple[Item, dict[bytes, Item]]] = []
        for item in sorted(self.per.held):
            if (item.time, item.seq) <= self.position:
                continue
            if len(taken) >= items_max or not self._have_passed(item.time, self.tolerance):
                break
            self.position = item.time, item.seq
            found = {one: self._partner(one, channel, item) for one, channel in self.others.items()}
            matched = {one: near for one, near in found.items() if near is not None}
            self.unmatched += len(matched) < len(found)
            taken.append((item, matched))
        return taken

    @property
    def is_overdue(self) -> bool:
        """Whether the next match should have been decided by now.

        That is so if each member has passed the whole chain of ever nearer items after the item of this match.
        """
        waiting = [item for item in sorted(self.per.held) if (item.time, item.seq) > self.position]
        far = self.tolerance * (2 * len(waiting) + 2)
        if not waiting:
            return False
        return self._have_passed(waiting[0].time, far) and self._passed(self.per, waiting[0].time + far)

    def _have_passed(self, time: int, tolerance: int) -> bool:
        others = all(self._passed(other, time + tolerance) for other in self.others.values())
        return others and self._passed(self.per, time)

    def _partner(self, name: bytes, channel: OracleChannel, item: Item) -> Item | None:
        if self.last is None:
            return self._nearest(channel, item.time)
        own = [(one.time, one.seq) for one in self.per.held if (one.time, one.seq) >= (item.time, item.seq)]
        last = self.last.get(name, (-(2**64), 0))
        others = {(one.time, one.seq): one for one in channel.held if (one.time, one.seq) > last}
        key = paired(own, others, self.tolerance).get((item.time, item.seq))
        if key is None:
            return None
        self.last[name] = key
        return others[key]

    def _passed(self, channel: OracleChannel, instant: int) -> bool:
        """Whether the channel has passed the instant.

        It has an item at or after the instant (later than the instant by more than the lateness, if there is one), or
        it promised that no item comes up to the instant.
        """
        promised = channel.advanced_to is not None and channel.advanced_to > instant
        least = instant + self.lateness + 1 if self.lateness else instant
        return promised or any(one.time >= least for one in channel.log.values())

    def _nearest(self, channel: OracleChannel, time: int) -> Item | None:
        near = [one for one in channel.held if abs(one.time - time) <= self.tolerance]
        return min(near, key=lambda one: (abs(one.time - time), one.time, one.seq), default=None)
