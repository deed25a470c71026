"""The cut of a group: the instant up to which its channels are visible (paper, section 3.3). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from heapq import heapreplace
from typing import NamedTuple

from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.group.times import ChannelTimes, KnownTimes, TimesBoard

MAX_LEAD_NANOS_DEFAULT = 5_000_000_000
"""The default of `GroupDefinition.max_lead_nanos`."""

_BEFORE_ALL = -(1 << 64)  # an instant before the cuts of all members


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupDefinition:
    """The members and settings of a group.

    If `reference` is None, the group's cut is the smallest cut of all members ("oldest"). With `by_end`, a channel's
    cut is the latest time plus duration of the items in its newest bucket, at most `max_lead_nanos` after the bucket's
    time. "oldest" leaves out a member that has been silent for `idle_after_nanos`. Only cuts of the same `incarnation`
    can be compared.
    """

    members: frozenset[bytes]
    reference: bytes | None = None
    by_end: bool = False
    idle_after_nanos: int | None = None
    max_lead_nanos: int = MAX_LEAD_NANOS_DEFAULT
    incarnation: int = 1
    spec_version: int = 1

    def cut_of(self, times: ChannelTimes) -> int | None:
        """The cut of one channel without the others, or None if the channel never had an item or an advance."""
        newest = times.newest
        if newest is None:
            return times.advance
        cut = newest
        if self.by_end and times.newest_end is not None:
            cut = max(newest, min(times.newest_end, clamp(newest + self.max_lead_nanos)))
        return cut if times.advance is None else max(cut, times.advance)


class CutFloor(NamedTuple):
    """The cut up to which a host has shown a group. No host may show less of the group within one incarnation."""

    group_id: bytes
    incarnation: int
    cut: int
    spec_version: int


class CutMember(NamedTuple):
    """One member at one moment.

    `known` is None if its owner has reported nothing yet. `cut` is its own cut, or None if it has none.
    """

    channel_id: bytes
    known: KnownTimes | None
    cut: int | None
    is_idle: bool

    @property
    def mark(self) -> int | None:
        """The later of its newest item's time and its advance, or None if it has neither."""
        return None if self.known is None else self.known.times.mark


class GroupCut:
    """The cut of one group as one host knows it. Within an incarnation it never moves back.

    The caller first makes the object. It then calls `merge_floor` with the cuts of the group's other hosts, and
    `confirm` as soon as all live hosts have reported their cuts. Before `confirm` no item is visible, because a reader
    may have seen a later cut. From then on the caller calls `refresh` after each change of the board and at
    `next_idle`.
    """

    def __init__(self, definition: GroupDefinition, board: TimesBoard) -> None:
        self._definition = definition
        self._board = board
        self._floor: int | None = None
        self._confirmed = False
        self._holder = b""  # the member that had the lowest cut at the last look at all members
        # A heap with a former cut of each member. A former cut is at or below the member's present cut.
        self._lows: list[tuple[int, bytes]] = []
        self._setbacks = -1  # `TimesBoard.setbacks` when the heap was made

    @property
    def definition(self) -> GroupDefinition:
        """The latest definition."""
        return self._definition

    @property
    def is_confirmed(self) -> bool:
        """Whether `confirm` was called in this incarnation: all other live hosts have reported their cuts."""
        return self._confirmed

    @property
    def cut(self) -> int | None:
        """The instant before which items are visible, as of the last refresh. None if no item is visible."""
        return self._floor if self._confirmed else None

    @property
    def holder(self) -> bytes | None:
        """The member that holds the cut back: only a change of this member can raise the cut.

        None: the cut is not confirmed yet, or the group has no members. The answer is as of the last refresh. Do not
        use it for groups with `idle_after_nanos`, because any change may raise their cuts.
        """
        if not self._confirmed:
            return None
        if self._counts_by_heap():
            return self._lows[0][1] if self._lows else None
        return self._holder or None

    def define(self, definition: GroupDefinition) -> None:
        """Set another definition. The cut stays the same, unless the definition has another incarnation.

        In another incarnation the group has no cut until `confirm` is called again.
        """
        if definition.incarnation != self._definition.incarnation:
            self._floor, self._confirmed = None, False
        self._definition = definition
        self._holder, self._setbacks = b"", -1

    def merge_floor(self, cut: int) -> bool:
        """Raise the cut to `cut`, which another host of the group has reported.

        Returns True if the cut rose. Never call this method with a client's cut.
        """
        if self._floor is not None and cut <= self._floor:
            return False
        self._floor = cut
        return True

    def confirm(self) -> None:
        """Note that all other live hosts have reported their cuts. From now on the host may raise and show the cut."""
        self._confirmed = True

    def refresh(self, now: int) -> bool:
        """Raise the cut to the cut of the reference, or to the smallest cut of the members. Returns True if it rose."""
        reached = self._reached(now) if self._confirmed else None
        return reached is not None and self.merge_floor(reached)

    def member(self, channel_id: bytes, now: int) -> CutMember:
        """One member at this moment."""
        known = self._board.find(channel_id)
        cut = None if known is None else self._definition.cut_of(known.times)
        return CutMember(channel_id, known, cut, self._is_idle(known, now))

    def members(self, now: int) -> Iterator[CutMember]:
        """All members, in the order of their ids."""
        return (self.member(channel_id, now) for channel_id in sorted(self._definition.members))

    def waiting_on(self, now: int) -> list[bytes]:
        """The members that hold the group's cut back: they count for it, and their own cuts are not later than the
        group's cut.
        """
        cut = self.cut
        owns = ((channel_id, self._own_cut(channel_id)) for channel_id in self._counting(now))
        return sorted(channel_id for channel_id, own in owns if own is None or (cut is not None and own <= cut))

    def next_idle(self, now: int) -> int | None:
        """The time at which a member at this host next becomes idle, or None. This may move the cut without a put.

        It leaves out members at other hosts. This host learns how long they have been silent when a report or a sign of
        life of their owner comes.
        """
        after = self._definition.idle_after_nanos
        if after is None or self._definition.reference is not None:
            return None
        known = (self._board.find(channel_id) for channel_id in self._definition.members)
        own = (one for one in known if one is not None and one.known_until is None)
        return min((one.silent_since + after for one in own if one.silent_nanos(now) < after), default=None)

    def _reached(self, now: int) -> int | None:
        """The smallest cut of the members that count. None if one of them has no cut, or still holds the cut back."""
        if self._counts_by_heap():
            return self._lowest_of_all()
        if self._holder and self._still_holds(now):
            return None
        lowest: int | None = None
        for channel_id in self._counting(now):
            cut = self._own_cut(channel_id)
            if cut is None or lowest is None or cut < lowest:
                lowest, self._holder = cut, channel_id
            if cut is None:
                return None
        return lowest

    def _counts_by_heap(self) -> bool:
        definition = self._definition
        return definition.reference is None and not definition.by_end and definition.idle_after_nanos is None

    def _still_holds(self, now: int) -> bool:
        """Whether the member that held the cut back at the last look still holds it back.

        Most changes concern other members. While this member holds the cut back, a look at all members is not
        necessary.
        """
        known = self._board.find(self._holder)
        if self._is_idle(known, now):
            return False
        cut = self._own_cut(self._holder)
        return cut is None or (self._floor is not None and cut <= self._floor)

    def _lowest_of_all(self) -> int | None:
        """Return the same as `_reached`. Only for "oldest" without `idle_after_nanos` and without `by_end`.

        Then the cut of a member falls only at a setback (see `TimesBoard`). So the first member of the heap whose
        present cut equals its cut in the heap has the lowest cut. Costs one step for each member whose cut has risen
        since the last call.
        """
        if self._setbacks != self._board.setbacks:
            self._setbacks = self._board.setbacks
            self._lows = [(_BEFORE_ALL, channel_id) for channel_id in self._definition.members]
        while self._lows:
            seen, channel_id = self._lows[0]
            cut = self._own_cut(channel_id)
            if cut is None or cut == seen:
                return cut
            heapreplace(self._lows, (cut, channel_id))
        return None

    def _own_cut(self, channel_id: bytes) -> int | None:
        """The cut of one member without the others, or None if it has none."""
        known = self._board.find(channel_id)
        return None if known is None else self._definition.cut_of(known.times)

    def _counting(self, now: int) -> Iterable[bytes]:
        """The members whose cuts decide the group's cut: the reference, or all members that are not idle.

        If all members are idle, only the member that became idle last counts. Just before it became idle, it was
        already the only member that counted, so the group's cut does not change.
        """
        definition = self._definition
        if definition.reference is not None:
            return (definition.reference,)
        if definition.idle_after_nanos is None:
            return definition.members
        members = {channel_id: self._board.find(channel_id) for channel_id in definition.members}
        awake = [channel_id for channel_id, known in members.items() if not self._is_idle(known, now)]
        if awake:
            return awake
        silences = {channel_id: known.silent_since for channel_id, known in members.items() if known is not None}
        last = max(silences.values(), default=None)
        return [channel_id for channel_id, since in silences.items() if since == last]

    def _is_idle(self, known: KnownTimes | None, now: int) -> bool:
        after = self._definition.idle_after_nanos
        return after is not None and known is not None and known.silent_nanos(now) >= after
