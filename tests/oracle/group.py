"""Groups by the book: cuts, what they show, what becomes visible when, and what matches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.values.timeline import MetaTime, ResolvedInterval
from stampede_rt_channel_host.core.channel import Query
from tests.oracle.channel import Item, OracleChannel
from tests.oracle.pairs import paired
from tests.oracle.reading import OracleReader, _remaining


@dataclass(frozen=True)
class Told:
    """How far a channel was, as its owner said at some time. `end`: the largest by duration in its newest bucket."""

    epoch: int
    incarnation: int
    newest: int | None
    end: int | None
    advance: int | None


@dataclass
class OracleMember:
    """A channel as its owner knows it, who looks after every put from some moment on."""

    channel: OracleChannel
    epoch: int
    incarnation: int
    spoke_at: int
    ends: dict[int, int] = field(default_factory=dict)  # by time of the bucket: the largest end that was seen in it
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

    def says(self) -> Told:
        """Collection takes nothing back: every item that ever was counts."""
        newest = max((one.time for one in self.channel.log.values()), default=None)
        end = None if newest is None else self.ends.get(newest)
        return Told(self.epoch, self.incarnation, newest, end, self.channel.advanced_to)


@dataclass
class OracleHeard:
    """What a host was told of a channel by those who owned it. `known_until` None: it is the owner."""

    said: Told
    silent_since: int
    known_until: int | None
    told: list[Told] = field(default_factory=list)  # all that was ever said

    @property
    def mark(self) -> int | None:
        """The later of the newest item's time and the advance."""
        return max((one for one in (self.said.newest, self.said.advance) if one is not None), default=None)

    def cut(self, *, by_end: bool, max_lead: int) -> int | None:
        said = self.said
        cuts = [one for one in (said.newest, said.advance) if one is not None]
        if by_end and said.newest is not None and said.end is not None:
            cuts.append(min(said.end, said.newest + max_lead))
        return max(cuts, default=None)


def all_in_all(told: list[Told]) -> Told:
    """How far the channel is by everything that was said of its present life: an earlier one's items are lost."""
    epoch = max(one.epoch for one in told)
    life = next(one.incarnation for one in told if one.epoch == epoch)
    valid = [one for one in told if one.incarnation == life]
    newest = max((one.newest for one in valid if one.newest is not None), default=None)
    end = max((one.end for one in valid if one.end is not None and one.newest == newest), default=None)
    advance = max((one.advance for one in valid if one.advance is not None), default=None)
    return Told(epoch, life, newest, end, advance)


class OracleBoard:
    """What one host was told of all channels."""

    def __init__(self) -> None:
        self.heard: dict[bytes, OracleHeard] = {}

    def own(self, channel_id: bytes, member: OracleMember) -> None:
        self._enter(channel_id, member.says(), member.spoke_at, None)

    def hear(self, channel_id: bytes, owner: OracleHeard, clock: int) -> None:
        """The owner tells all that it knows."""
        self._enter(channel_id, owner.said, owner.silent_since, clock)

    def _enter(self, channel_id: bytes, told: Told, silent_since: int, known_until: int | None) -> None:
        heard = self.heard.setdefault(channel_id, OracleHeard(told, silent_since, known_until))
        heard.silent_since, heard.known_until = silent_since, known_until
        if told not in heard.told:
            heard.told.append(told)
            heard.said = all_in_all(heard.told)

    def disown(self, channel_id: bytes, clock: int) -> None:
        heard = self.heard.get(channel_id)
        if heard is not None and heard.known_until is None:
            heard.known_until = clock


@dataclass
class OracleGroup:
    """The cut of a group at one host; `observe` after each thing that happens. Shows nothing before it is settled."""

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

    def heard(self, channel_id: bytes) -> OracleHeard | None:
        return self.board.heard.get(channel_id)

    def cut_of(self, channel_id: bytes) -> int | None:
        heard = self.heard(channel_id)
        return None if heard is None else heard.cut(by_end=self.by_end, max_lead=self.max_lead)

    def mark_of(self, channel_id: bytes) -> int | None:
        heard = self.heard(channel_id)
        return None if heard is None else heard.mark

    def is_idle(self, channel_id: bytes, clock: int) -> bool:
        """Silent for so long as far as the host knows; of whom it never heard, it does not know."""
        heard = self.heard(channel_id)
        if heard is None or self.idle_after is None:
            return False
        until = clock if heard.known_until is None else heard.known_until
        return max(0, until - heard.silent_since) >= self.idle_after

    def next_idle(self, clock: int) -> int | None:
        """When one of this host's members falls idle and is left out, if none speaks."""
        if self.idle_after is None or self.reference is not None:
            return None
        awake = [self.heard(one) for one in self.members if not self.is_idle(one, clock)]
        own = [one.silent_since for one in awake if one is not None and one.known_until is None]
        return min(own) + self.idle_after if own else None

    def counting(self, clock: int) -> list[bytes]:
        """The members that the reference is chosen from; of none but silent ones, those that spoke last."""
        if self.reference is not None:
            return [self.reference]
        awake = [one for one in self.members if not self.is_idle(one, clock)]
        spoke = {one: heard.silent_since for one in self.members if (heard := self.heard(one)) is not None}
        return awake or [one for one in spoke if spoke[one] == max(spoke.values())]

    def reached(self, clock: int) -> int | None:
        cuts = [self.cut_of(one) for one in self.counting(clock)]
        known = [one for one in cuts if one is not None]
        return min(known) if cuts and len(known) == len(cuts) else None

    def waiting_on(self, clock: int) -> list[bytes]:
        """The counting members that are not past the cut."""
        cuts = {one: self.cut_of(one) for one in self.counting(clock)}
        return sorted(one for one, own in cuts.items() if own is None or (self.cut is not None and own <= self.cut))

    def due(self, cut: int, since: int, max_wait: int, lateness: int, clock: int) -> tuple[bool, tuple[bytes, ...]]:
        """Whether an event for a cut that was reached at some time is due, and which members are behind."""
        behind = tuple(one for one in sorted(self.members) if not self._is_at(one, cut, lateness))
        waits = clock < since + max_wait + lateness and any(not self.is_idle(one, clock) for one in behind)
        return not waits, behind

    def _is_at(self, channel_id: bytes, cut: int, lateness: int) -> bool:
        """Nothing before the cut is to come any more that is not later than it may be."""
        heard = self.heard(channel_id)
        if heard is None:
            return False
        newest, advance = heard.said.newest, heard.said.advance
        return (newest is not None and newest >= cut + lateness) or (advance is not None and advance >= cut)

    def between(self, low: int | None, high: int, lateness: int, clock: int) -> int | None:
        """The latest instant after `low` and before `high` at which all are that are waited for."""
        awake = [one for one in sorted(self.members) if not self.is_idle(one, clock)]
        tried = [one.said for one in (self.heard(each) for each in awake) if one is not None]
        marks = [said.newest - lateness for said in tried if said.newest is not None]
        marks += [said.advance for said in tried if said.advance is not None]
        fit = [mark for mark in marks if mark < high and all(self._is_at(one, mark, lateness) for one in awake)]
        latest = max(fit, default=None)
        return None if latest is None or (low is not None and latest <= low) else latest


class _Shown(OracleChannel):
    """The items before the cut, as a channel of their own, apart from what retention has done."""

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
    """Reads through a group, under a clock that stops at the cut."""

    def __init__(self, full: OracleChannel, clock: int, cut: int | None) -> None:
        full.age(clock)
        self.full, self.real_clock, self.cut = full, clock, cut
        self.channel = _Shown(full, cut)
        self.clock = clock if cut is None else min(clock, cut)

    @property
    def newest_key(self) -> tuple[int, int] | None:
        """Of the latest visible item."""
        return max(((one.time, one.seq) for one in self.channel.held), default=None)

    @property
    def window_is_too_short(self) -> bool:
        """Something went before it was shown, or the channel keeps less than it is ahead of the cut."""
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
        """The first whole nanosecond inside, if a clock that stops at the cut comes there later."""
        first = within.start + 1 if within.start_exclusive else within.start
        ahead = first > self.channel.now(self.clock)
        return first if ahead and self.cut is not None and first <= self.cut else None

    def resolve(self, query: Query) -> ResolvedInterval | None:
        if self.cut is None and MetaTime.NOW in (query.interval.start.meta, query.interval.end.meta):
            return None
        return super().resolve(query)

    def _is_finished(self, region: ResolvedInterval) -> bool:
        """The channel, hidden items and all, has passed it, and the cut has."""
        if self.cut is None or not OracleReader(self.full, self.real_clock)._is_finished(region):
            return False
        return self.cut >= region.end if region.end_exclusive else self.cut > region.end

    def hides_an_item_of(self, query: Query, interval: ResolvedInterval) -> bool:
        """The whole channel would have given items that the cut hides."""
        reader = OracleReader(self.full, self.real_clock)
        plain = Query(interval=query.interval, match=query.match, newest_first=query.newest_first,
                      after=query.after, newer_than=query.newer_than)  # fmt: skip
        return any(self.cut is None or one.time >= self.cut for one in reader.read(plain, interval).items)

    def reason(self, query: Query, interval: ResolvedInterval | None) -> str | None:
        """Why an answer is empty or partial: as for a channel, but what the cut holds back is HIDDEN."""
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
    """A reader to whom every item becomes visible once. `owed`: the seqs meant for it that it has not heard of."""

    channel: OracleChannel
    cut: int | None
    owed: set[int]
    seen_seq: int

    @classmethod
    def begin(cls, channel: OracleChannel, cut: int | None, after_seq: int | None = None) -> OracleFollower:
        """What lies at or past the cut is owed, and with `after_seq` whatever has a later seq, even if it is gone."""
        owed = {one.seq for one in channel.held if cut is None or one.time >= cut}
        return cls(channel, cut, owed, len(channel.log) if after_seq is None else after_seq)

    @property
    def meant(self) -> set[int]:
        """What is owed, and what was accepted since the last step."""
        return self.owed | set(range(self.seen_seq + 1, len(self.channel.log) + 1))

    def owe(self) -> None:
        """Take note of everything that was accepted up to now."""
        self.owed = self.meant
        self.seen_seq = len(self.channel.log)

    def end_step(self, cut: int, new: list[Item], late: list[Item]) -> set[int]:
        """A step to `cut` brought these; checks them, and gives the items that are lost since the last step."""
        before = self.cut
        assert new == sorted(new)
        assert late == sorted(late)
        assert all(one.time < cut and (before is None or one.time >= before) for one in new)
        assert all(before is not None and one.time < before for one in late)
        seqs = [one.seq for one in new + late]
        assert len(set(seqs)) == len(seqs)
        assert set(seqs) <= self.owed, "nothing twice, and nothing that is not meant for it"
        self.owed -= set(seqs)
        gone = self.pass_over(cut)
        assert not gone & self.visible(cut), "nothing is left out"
        return gone - self.visible(cut)

    def visible(self, cut: int) -> set[int]:
        """The seqs of what a group shows."""
        return {one.seq for one in self.channel.held if one.time < cut}

    def pass_over(self, cut: int) -> set[int]:
        """What is owed, and was not given though it is visible, or is gone."""
        held = {one.seq for one in self.channel.held}
        passed = {seq for seq in self.owed if seq not in held} | (self.owed & self.visible(cut))
        self.owed -= passed
        self.cut = cut
        return passed


@dataclass
class OracleMatcher:
    """Each item of one channel in time order, with the nearest of every other member.

    If `last` is not None no item of another member comes twice: it has the last partner of each.
    """

    per: OracleChannel
    others: Mapping[bytes, OracleChannel]
    tolerance: int
    position: tuple[int, int]
    lateness: int = 0
    last: dict[bytes, tuple[int, int]] | None = None
    unmatched: int = 0

    def take(self, items_max: int) -> list[tuple[Item, dict[bytes, Item]]]:
        """With `last`, what waits for a nearer item counts as settled, too: `items_max` says how much is."""
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
    def stalls(self) -> bool:
        """The next item could be settled: the whole chain of ever nearer items behind it has been passed."""
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
        """It had an item at or after the instant, or one that is by more than the lateness after it; or it promised
        that none comes up to the instant."""
        promised = channel.advanced_to is not None and channel.advanced_to > instant
        least = instant + self.lateness + 1 if self.lateness else instant
        return promised or any(one.time >= least for one in channel.log.values())

    def _nearest(self, channel: OracleChannel, time: int) -> Item | None:
        near = [one for one in channel.held if abs(one.time - time) <= self.tolerance]
        return min(near, key=lambda one: (abs(one.time - time), one.time, one.seq), default=None)
