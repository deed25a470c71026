"""Matches of items by only their keys, for readers that get the items from archives. Pure.

It has the same rule as the host's `Matcher`, which also finds the items.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import NamedTuple

from stampede_rt.matching.item_keys import FIRST_KEY, ItemKey
from stampede_rt.matching.key_track import KeyTrack
from stampede_rt.matching.pairing import Pairing, PartnerUndecided
from stampede_rt.values.timeline import clamp

HasPassed = Callable[[bytes, int], bool]
"""Returns True if a channel, named by its id, can get no more items up to the given instant, inclusive."""


class KeyMatch(NamedTuple):
    """The key of one item, and the key of its partner in each channel that has one within the tolerance."""

    key: ItemKey
    partners: Mapping[bytes, ItemKey]


def has_passed(newest: int | None, advance: int | None, instant: int, lateness_nanos: int) -> bool:
    """Return whether no item can come at or before `instant`, if items are at most `lateness_nanos` behind the newest.

    `newest` is the time of the newest item, `advance` the highest advance; each may be None. A lateness of 0
    says that items come in order. Then the function returns True as soon as the newest item is at `instant`, although
    more items with the same time may come. No item comes before an advance.
    """
    by_item = newest is not None and newest - lateness_nanos >= instant + bool(lateness_nanos)
    return by_item or (advance is not None and advance > instant)


class KeyMatcher:
    """Matches the keys of one channel, in the order of time, with the nearest key of every other channel.

    The caller adds keys, also late ones, and takes the decided matches. `unique`: each key of another channel goes into
    one match at most (see `Pairing`). `low`: the keys of the channel `per` from this key on get a match.
    """

    def __init__(self, per: bytes, others: Iterable[bytes], tolerance: int, low: ItemKey, *, unique: bool) -> None:
        self._per, self._tolerance = per, tolerance
        self._own = KeyTrack()
        self._others = {one: KeyTrack() for one in others}
        self._partners: dict[bytes, ItemKey] | None = {} if unique else None
        self.low = low

    def __len__(self) -> int:
        """The number of keys that it holds."""
        return len(self._own) + sum(map(len, self._others.values()))

    @property
    def next_time(self) -> int | None:
        """The time of the next key to match; None if it has none."""
        key = self._own.first_from(self.low)
        return None if key is None else key[0]

    def add(self, channel_id: bytes, keys: Iterable[ItemKey]) -> int:
        """Add keys of a channel. Returns how many of them belong to the matched channel and are too late for a
        match."""
        if channel_id != self._per:
            self._others[channel_id].add(keys)
            return 0
        known = list(keys)
        in_time = [one for one in known if one >= self.low]
        self._own.add(in_time)
        return len(known) - len(in_time)

    def take(self, passed: HasPassed) -> KeyMatch | None:
        """Take the next match; None if there is no further key, or if a later item may change the match."""
        key = self._own.first_from(self.low)
        if key is None or not self._can_decide(key[0], passed):
            return None
        try:
            found = {one: self._partner(one, track, key, passed) for one, track in self._others.items()}
        except PartnerUndecided:
            return None
        partners = {one: near for one, near in found.items() if near is not None}
        if self._partners is not None:
            self._partners.update(partners)
        self.low = key[0], key[1] + 1
        self.forget()
        return KeyMatch(key, partners)

    def forget(self) -> None:
        """Forget the keys that no later match needs."""
        for track in (self._own, *self._others.values()):
            track.forget_before(self.low[0] - self._tolerance)

    def _can_decide(self, time: int, passed: HasPassed) -> bool:
        others = all(passed(one, clamp(time + self._tolerance)) for one in self._others)
        return others and passed(self._per, time)

    def _partner(self, channel_id: bytes, track: KeyTrack, key: ItemKey, passed: HasPassed) -> ItemKey | None:
        if self._partners is None:
            near = track.nearest(key[0], self._tolerance, 0)
        else:
            last = self._partners.get(channel_id)
            after = FIRST_KEY if last is None else (last[0], last[1] + 1)
            pairing = Pairing(self._own, track, after, partial(passed, self._per), partial(passed, channel_id), 0)
            near = pairing.partner(key, self._tolerance)
        return None if near is None else (near.time, near.seq)
