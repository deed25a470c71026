"""Pairs of two channels' items in which each item is once at the most: the nearest pairs first (decision 0073). Pure.

Of all pairs within the tolerance the one of the least distance is made; then, by the same rule, what lies before both
of its items is paired, and what lies behind both. Of equally near pairs that with the earlier items is made. So pairs
do not cross: the partner of a later item is a later one.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.channel.index import LAST_KEY, ItemKey
from stampede_rt_channel_host.core.group.tracks import Nearest, Track

STEPS_MAX = 16

HasPassed = Callable[[int], bool]


class Undecided(Exception):
    """An item that is still to come may be nearer."""


class Pairing:
    """Pairs `own` items, in the order of time, with those of `other` at or above `after`.

    Whether an item gets its nearest depends on the later items that are nearer to that one, which depends on what is
    nearer to those, and so on, at ever smaller distances. That is followed for STEPS_MAX steps; then the item gets its
    nearest of those left. `looks` counts looks for a nearest item.
    """

    def __init__(
        self, own: Track, other: Track, after: ItemKey, own_has_passed: HasPassed, other_has_passed: HasPassed, now: int
    ) -> None:  # fmt: skip
        self._own = own
        self._other = other
        self._after = after
        self._own_has_passed = own_has_passed
        self._other_has_passed = other_has_passed
        self._now = now
        self.looks = 0

    def partner(self, key: ItemKey, tolerance: int) -> Nearest | None:
        """The partner of the first own item left; `other` has passed its time + tolerance. Raises Undecided."""
        end, other_end = (
            LAST_KEY,
            LAST_KEY,
        )  # of what is not paired: a pair hides all that is behind one of its items
        chain = [(key, tolerance)]  # each is nearer than the one before it to what that one would get
        for _ in range(STEPS_MAX):
            one, reach = chain[-1]
            self.looks += 2
            near = self._other.nearest(one[0], reach, self._now, self._after, other_end) if one < end else None
            rival = one if near is None else self._rival(key, one, near, end)
            if near is None or rival == one:
                chain.pop()
                if not chain:
                    return near
                end, other_end = (end, other_end) if near is None else (one, (near.time, near.seq))
                continue
            distance = abs(near.time - rival[0])
            if not self._other_has_passed(clamp(rival[0] + distance - 1)):
                raise Undecided
            chain.append((rival, distance))
        return self._other.nearest(key[0], tolerance, self._now, self._after, other_end)

    def _rival(self, first: ItemKey, one: ItemKey, near: Nearest, end: ItemKey) -> ItemKey:
        """The own item that is nearest to `near`; `one` is as near as told."""
        distance = abs(near.time - one[0])
        if not self._own_has_passed(clamp(near.time + distance - 1)):
            raise Undecided
        found = self._own.nearest(near.time, distance, self._now, first, end)
        return one if found is None else (found.time, found.seq)
