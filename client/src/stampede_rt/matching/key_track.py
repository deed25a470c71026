"""The keys of the items of one channel, for a search of the item nearest to an instant. Pure."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable
from typing import NamedTuple

from stampede_rt.matching.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey


class NearKey(NamedTuple):
    """The time and seq of a found item."""

    time: int
    seq: int


class KeyTrack:
    """Keys of items, in the order of time."""

    def __init__(self) -> None:
        self._keys: list[ItemKey] = []

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, keys: Iterable[ItemKey]) -> None:
        """Add the keys of some items."""
        for key in keys:
            if not self._keys or key > self._keys[-1]:
                self._keys.append(key)
            else:
                insort(self._keys, key)

    def first_from(self, low: ItemKey) -> ItemKey | None:
        """Return the first key at or above `low`; None if there is none."""
        at = bisect_left(self._keys, low)
        return self._keys[at] if at < len(self._keys) else None

    def nearest(
        self, time: int, tolerance: int, now: int, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY
    ) -> NearKey | None:
        """Return the key nearest to `time`, at most `tolerance` nanoseconds away; None if there is none.

        Of two equally near times the earlier one counts. Of several keys with one time, the key with the lowest seq
        counts. Only keys at or above `low` and below `high` count. `now` has no influence.
        """
        keys = self._keys
        first, end = bisect_left(keys, low), bisect_left(keys, high)
        above = min(max(first, bisect_left(keys, (time, SEQ_END))), end)
        earlier = keys[above - 1][0] if above > first else None
        later = keys[above][0] if above < end else None
        found = nearer(time, earlier, later, tolerance)
        return None if found is None else NearKey(*keys[bisect_left(keys, max(low, (found, 0)))])

    def forget_before(self, time: int) -> None:
        """Forget the keys before `time`."""
        del self._keys[: bisect_left(self._keys, (time, -1))]

    def keep_last(self, keys_max: int) -> None:
        """Forget the earliest keys beyond `keys_max`."""
        if len(self._keys) > keys_max:
            del self._keys[:-keys_max]


def nearer(time: int, earlier: int | None, later: int | None, tolerance: int) -> int | None:
    """Return the nearer of two times, or None if both are farther from `time` than the tolerance.

    Of two equally near times returns the earlier one.
    """
    near = [one for one in (earlier, later) if one is not None and abs(one - time) <= tolerance]
    return min(near, key=lambda one: (abs(one - time), one), default=None)
