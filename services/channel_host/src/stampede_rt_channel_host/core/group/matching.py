"""Finds for each item of one channel the nearest item of every other member, for example for two cameras. Pure.

See the paper, section 3.3. A match does not depend on the cut: it looks at all items, hidden items included. It waits
until the items that it needs have come.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import islice

from stampede_rt.matching.pairing import Pairing, PartnerUndecided
from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Position
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.selection import behind
from stampede_rt_channel_host.core.group.loss_counter import LossCounter
from stampede_rt_channel_host.core.group.recorded_track import ItemsNotLoaded, LateCounter, RecordedOwnTrack
from stampede_rt_channel_host.core.group.tracks import LocalTrack, NearestItem, Track

CREDIT_UNLIMITED = LOOKS_UNLIMITED = 1 << 62  # limits that no `take` reaches
OWN = b""
"""Stands for the matched channel itself, where other channels have their id."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundMatch:
    """One item, and its partner in each member. `missing` are the members that have no item within the tolerance."""

    item: DeliveredSlice
    matched: Mapping[bytes, NearestItem]
    missing: tuple[bytes, ...]

    @property
    def charge_bytes(self) -> int:
        """The bytes that its items at this host cost a reader's credit, without archived partners."""
        partners = (near.item for near in self.matched.values() if near.item is not None)
        return self.item.slice.charge_bytes + sum(one.slice.charge_bytes for one in partners)

    @property
    def archived(self) -> list[bytes]:
        """The members whose item the caller has still to read from the archive."""
        return [member for member, near in self.matched.items() if near.is_archived]


class Matcher:
    """Matches one channel's items in time order. The matcher keeps a position and no items: these wait in the channel.

    `unmatched` counts items for which a member had no partner. `dropped` counts items that were collected before their
    match, and items that came after the matcher had passed their time. Both are as of the last `take`. `has_more`: the
    last `take` used up its looks, so call it again without a wait.
    """

    def __init__(
        self, channel: ChannelCore, tracks: Mapping[bytes, Track], tolerance_nanos: int, now: int,
        after: Position | None = None, next_seq: int | None = None, partners: Mapping[bytes, ItemKey] | None = None,
        recorded: RecordedOwnTrack | None = None,
    ) -> None:  # fmt: skip
        """Begin with the items later than all present items or, with `after`, with the items after that position.

        Items before that position with `next_seq` or a later seq came too late for a match, and count as dropped. If
        the position is of another incarnation, all present items before it count as dropped. If `partners` is None, an
        item of another member may go into several matches. Otherwise it goes into one match only (see `Pairing`), and
        `partners` has the last partner in each member, after which the next ones come. `recorded`: the channel is
        recorded, and the items that memory does not have come from its archive.
        """
        held, _ = channel.look(now)
        self._channel = channel
        self._tracks = dict(tracks)
        self._tolerance = tolerance_nanos
        self._low = behind(after) if after is not None else max(_end(held.newest, channel.next_seq), held.floor)
        known = channel.next_seq if next_seq is None else min(next_seq, channel.next_seq)
        if next_seq is not None and after is not None and after.incarnation not in (0, channel.incarnation):
            known = 1
        self._own = recorded or LocalTrack(channel)
        self._loss_counter: LossCounter | LateCounter = (
            LossCounter(held, self._low, known) if recorded is None else LateCounter(recorded, self._low, known)
        )
        self._partners = None if partners is None else dict(partners)
        self.unmatched = 0
        self.dropped = 0
        self.has_more = False
        self._looks_left = 0
        # The item at which the last `take` used up its looks, and the partners already found for this item.
        self._unfinished_search: tuple[ItemKey, dict[bytes, NearestItem | None]] | None = None

    @property
    def position(self) -> Position:
        """The position up to which all items are decided. Another matcher can continue `after` this position."""
        time, end_seq = self._low
        return Position(clamp(time), end_seq - 1 if end_seq else None, self._channel.incarnation)

    @property
    def next_seq(self) -> int:
        """The matcher is done with all items up to `position` that have a lower seq than this."""
        return self._loss_counter.next_seq

    @property
    def partners(self) -> Mapping[bytes, ItemKey]:
        """The last partner in each member as of `position`. Empty if items may go into several matches."""
        return self._partners or {}

    @property
    def earliest(self) -> int:
        """The instant before which the matcher needs no items of other members."""
        return clamp(self._low[0] - self._tolerance)

    def set_tracks(self, tracks: Mapping[bytes, Track]) -> None:
        """Replace the tracks of the members, because members came, left, or moved to another host."""
        self._tracks = dict(tracks)
        self._unfinished_search = None

    def take(
        self, has_passed: Callable[[bytes, int], bool], now: int, items_max: int, credit_bytes: int = CREDIT_UNLIMITED,
        looks_max: int = LOOKS_UNLIMITED,
    ) -> list[FoundMatch]:  # fmt: skip
        """Take the next decided matches, at most `items_max`. Takes no match when the credit is used up.

        Searches a member's nearest item about `looks_max` times. If the searches for an item are not finished then, the
        next call continues them. `has_passed(member, instant)` returns True if the member can get no more items up to
        `instant` (see `ChannelTimes.has_passed`), or if matches do not wait for the member. `take` also calls it with
        OWN. A match with an archived partner is the last of a call. Raises ItemsNotLoaded if the next match needs
        archived items that no page has.
        """
        held, _ = self._channel.look(now)
        taken: list[FoundMatch] = []
        self._looks_left = looks_max
        # a list first, because each look may free entries
        for item in [*islice(self._own.one_by_one(self._low, now), items_max)] if credit_bytes > 0 else ():
            one = item.slice
            if credit_bytes <= 0 or not self._can_decide(one.first_time, has_passed):
                break
            found = self._found((one.first_time, one.first_seq), has_passed, now, may_raise=not taken)
            if found is None:
                break
            taken.append(self._match(item, found))
            credit_bytes -= taken[-1].charge_bytes
            self._low = one.first_time, one.end_seq
            if taken[-1].archived:
                break
        self.dropped += self._loss_counter.mark_read(
            held, self._low, self._channel.next_seq, given_above=len(taken), given_below=0
        )
        self._forget_before(self._low[0])
        self.has_more = self._looks_left <= 0
        return taken

    def _forget_before(self, time: int) -> None:
        """Let the tracks forget the items that no match of an item from `time` on needs."""
        for track in (self._own, *self._tracks.values()):
            track.forget_before(time - self._tolerance)

    def _can_decide(self, time: int, has_passed: Callable[[bytes, int], bool]) -> bool:
        """Whether no item that comes later can change the match of an item at `time`."""
        others = all(has_passed(channel_id, clamp(time + self._tolerance)) for channel_id in self._tracks)
        return others and has_passed(OWN, time)

    def _found(
        self, key: ItemKey, has_passed: Callable[[bytes, int], bool], now: int, *, may_raise: bool
    ) -> dict[bytes, NearestItem | None] | None:  # fmt: skip
        """The partner in each member. None if a partner is not decided yet, or if the looks are used up.

        If archived items are missing, raises ItemsNotLoaded, or without `may_raise` returns None.
        """
        unfinished, self._unfinished_search = self._unfinished_search, None
        found = unfinished[1] if unfinished is not None and unfinished[0] == key else {}
        for member, track in self._tracks.items():
            if member in found:
                continue
            if self._looks_left <= 0:
                self._unfinished_search = key, found
                return None
            try:
                found[member] = self._found_in(member, track, key, has_passed, now)
            except PartnerUndecided:
                return None
            except ItemsNotLoaded:
                self._unfinished_search = key, found
                self._forget_before(key[0])
                if may_raise:
                    raise
                return None
        if self._partners is not None:
            near = ((member, one) for member, one in found.items() if one is not None)
            self._partners.update({member: (one.time, one.seq) for member, one in near})
        return found

    def _found_in(
        self, member: bytes, track: Track, key: ItemKey, has_passed: Callable[[bytes, int], bool], now: int
    ) -> NearestItem | None:
        """The partner in one member. Raises PartnerUndecided if an item still to come may change the partner."""
        if self._partners is None:
            self._looks_left -= 1
            return track.nearest(key[0], self._tolerance, now)
        after = _behind(self._partners.get(member))
        pairing = Pairing(self._own, track, after, partial(has_passed, OWN), partial(has_passed, member), now)
        try:
            return pairing.partner(key, self._tolerance)
        finally:
            self._looks_left -= pairing.looks

    def _match(self, item: DeliveredSlice, found: Mapping[bytes, NearestItem | None]) -> FoundMatch:
        """Make the match of an item, and count it if a member has no partner."""
        matched = {member: near for member, near in found.items() if near is not None}
        missing = tuple(sorted(found.keys() - matched.keys()))
        self.unmatched += bool(missing)
        return FoundMatch(item=item, matched=matched, missing=missing)


def _behind(key: ItemKey | None) -> ItemKey:
    """The first key after the item of `key`, or FIRST_KEY if `key` is None."""
    return FIRST_KEY if key is None else (key[0], key[1] + 1)


def _end(newest: int | None, next_seq: int) -> ItemKey:
    """A key above the keys of all present items."""
    return FIRST_KEY if newest is None else (newest, next_seq)
