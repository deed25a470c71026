"""Groups by the book: cuts, what they show, what becomes visible when, and what matches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.timeline import MetaTime, ResolvedInterval
from stampede_rt_channel_host.core.channel import Query
from tests.oracle.channel import Item, OracleChannel
from tests.oracle.reading import OracleReader, _remaining


@dataclass
class OracleMember:
    """A channel as somebody sees it who looks after every put: how far it ever was, and when it last said something."""

    channel: OracleChannel
    spoke_at: int
    newest: int | None = None
    ends: list[int] = field(default_factory=list)  # by duration, of what was ever seen in the newest bucket

    def observe(self, clock: int, *, spoke: bool) -> None:
        self.spoke_at = clock if spoke else self.spoke_at
        newest = self.channel.newest
        if newest is None or (self.newest is not None and newest < self.newest):
            return
        if newest != self.newest:
            self.newest, self.ends = newest, []
        bucket = [one for one in self.channel.held if one.time == newest]
        self.ends += [newest + one.duration for one in bucket if one.duration is not None]

    @property
    def mark(self) -> int | None:
        """The later of the newest item's time and the advance."""
        return max([one for one in (self.newest, self.channel.advanced_to) if one is not None], default=None)

    def has_passed(self, instant: int) -> bool:
        advance = self.channel.advanced_to
        return (self.newest is not None and self.newest >= instant) or (advance is not None and advance > instant)

    def cut(self, *, by_end: bool, max_lead: int) -> int | None:
        cuts = [one for one in (self.newest, self.channel.advanced_to) if one is not None]
        if by_end and self.newest is not None and self.ends:
            cuts.append(min(max(self.ends), self.newest + max_lead))
        return max(cuts, default=None)


@dataclass
class OracleGroup:
    """The cut as somebody knows it who sees all channels at every moment; `observe` after each thing that happens."""

    members: dict[bytes, OracleMember]
    reference: bytes | None
    by_end: bool
    max_lead: int
    idle_after: int | None
    cut: int | None = None

    def observe(self, clock: int) -> None:
        reached = self.reached(clock)
        if reached is not None and (self.cut is None or reached > self.cut):
            self.cut = reached

    def cut_of(self, channel_id: bytes) -> int | None:
        return self.members[channel_id].cut(by_end=self.by_end, max_lead=self.max_lead)

    def is_idle(self, channel_id: bytes, clock: int) -> bool:
        return self.idle_after is not None and clock - self.members[channel_id].spoke_at >= self.idle_after

    def counting(self, clock: int) -> list[bytes]:
        """The members that the reference is chosen from; of none but silent ones, those that spoke last."""
        if self.reference is not None:
            return [self.reference]
        awake = [one for one in self.members if not self.is_idle(one, clock)]
        last = max(member.spoke_at for member in self.members.values())
        return awake or [one for one, member in self.members.items() if member.spoke_at == last]

    def reached(self, clock: int) -> int | None:
        cuts = [self.cut_of(one) for one in self.counting(clock)]
        known = [one for one in cuts if one is not None]
        return min(known) if cuts and len(known) == len(cuts) else None

    def waiting_on(self, clock: int) -> list[bytes]:
        """The counting members that are not past the cut."""
        cuts = {one: self.cut_of(one) for one in self.counting(clock)}
        return sorted(one for one, own in cuts.items() if own is None or (self.cut is not None and own <= self.cut))


class _Shown(OracleChannel):
    """The items before the cut, as a channel of their own, apart from what retention has done."""

    def __init__(self, full: OracleChannel, cut: int | None) -> None:
        self.__dict__.update(full.__dict__)
        self.held = [one for one in full.held if cut is not None and one.time < cut]
        self._full = full

    @property
    def frontier(self) -> int | None:
        return self._full.frontier


class OracleView(OracleReader):
    """Reads through a group, under a clock that stops at the cut."""

    def __init__(self, full: OracleChannel, clock: int, cut: int | None) -> None:
        full.age(clock)
        self.full, self.real_clock, self.cut = full, clock, cut
        self.channel = _Shown(full, cut)
        self.clock = clock if cut is None else min(clock, cut)

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
            return "HIDDEN" if self.full.held else "NOT_YET"
        hides = self.hides_an_item_of(query, interval)
        if answer.reason == "NOT_YET":
            passed = OracleReader(self.full, self.real_clock)._is_finished(_remaining(query, interval))
            return "HIDDEN" if hides or passed else "NOT_YET"
        if answer.items and answer.reason is None and hides and not (answer.more and not query.newest_first):
            return "HIDDEN"
        return answer.reason

    def known_end(self, item: Item) -> int | None:
        return self.channel.end(item)


@dataclass
class OracleFollower:
    """A reader to whom every item becomes visible once. `owed`: the seqs meant for it that it has not heard of."""

    channel: OracleChannel
    cut: int | None
    owed: set[int]
    seen_seq: int
    given: set[int] = field(default_factory=set)
    lost: int = 0

    @classmethod
    def begin(cls, channel: OracleChannel, cut: int | None) -> OracleFollower:
        owed = {one.seq for one in channel.held if cut is None or one.time >= cut}
        return cls(channel, cut, owed, len(channel.log))

    def owe(self, up_to_seq: int) -> None:
        """Take note of everything that was accepted up to a moment."""
        self.owed |= set(range(self.seen_seq + 1, up_to_seq + 1))
        self.seen_seq = up_to_seq

    def end_step(self, cut: int, new: list[Item], late: list[Item]) -> int:
        """A step to `cut` brought these; checks them, and gives how many items are lost since the last step."""
        before = self.cut
        assert new == sorted(new)
        assert late == sorted(late)
        assert all(one.time < cut and (before is None or one.time >= before) for one in new)
        assert all(before is not None and one.time < before for one in late)
        seqs = [one.seq for one in new + late]
        assert len(set(seqs)) == len(seqs)
        assert set(seqs) <= self.owed
        self.owed -= set(seqs)
        self.given |= set(seqs)
        held = {one.seq: one for one in self.channel.held}
        missed = [seq for seq in self.owed if seq in held and held[seq].time < cut]
        assert missed == []
        gone = {seq for seq in self.owed if seq not in held}
        self.owed -= gone
        self.cut = cut
        return len(gone)


@dataclass
class OracleMatcher:
    """Each item of one channel in time order, with the nearest of every other member."""

    per: OracleChannel
    others: Mapping[bytes, OracleMember]
    tolerance: int
    place: tuple[int, int]
    unmatched: int = 0

    def take(self) -> list[tuple[Item, dict[bytes, Item]]]:
        taken = []
        for item in sorted(self.per.held):
            if (item.time, item.seq) <= self.place:
                continue
            if not all(other.has_passed(item.time + self.tolerance) for other in self.others.values()):
                break
            self.place = item.time, item.seq
            found = {one: self._nearest(member.channel, item.time) for one, member in self.others.items()}
            matched = {one: near for one, near in found.items() if near is not None}
            self.unmatched += len(matched) < len(found)
            taken.append((item, matched))
        return taken

    def _nearest(self, channel: OracleChannel, time: int) -> Item | None:
        near = [one for one in channel.held if abs(one.time - time) <= self.tolerance]
        return min(near, key=lambda one: (abs(one.time - time), one.time, one.seq), default=None)
