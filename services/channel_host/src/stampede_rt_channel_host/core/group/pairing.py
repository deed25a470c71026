"""Pairs of two channels' items in which each item is once at the most: the nearest pairs first (decision 0073). Pure.

Of all pairs within the tolerance the one of the least distance is made; then, by the same rule, what lies before both
of its items is paired, and what lies behind both. Of equally near pairs that with the earlier items is made. So pairs
do not cross: the partner of a later item is a later one.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.timeline import clamp
from stampede_rt_channel_host.core.channel.index import LAST_PLACE, Place
from stampede_rt_channel_host.core.group.tracks import Nearest, Track

STEPS_MAX = 64

HasPassed = Callable[[int], bool]


class Undecided(Exception):
    """What is still to come may be nearer."""


class Pairing:
    """Pairs `own` items, in the order of time, with those of `other` at or above `after`.

    Whether an item gets its nearest depends on the later items that are nearer to that one, which depends on what is
    nearer to those, and so on, at ever smaller distances. That is followed for STEPS_MAX steps; then the item gets its
    nearest of those left.
    """

    def __init__(
        self, own: Track, other: Track, after: Place, own_has_passed: HasPassed, other_has_passed: HasPassed, now: int
    ) -> None:  # fmt: skip
        self._own = own
        self._other = other
        self._after = after
        self._own_has_passed = own_has_passed
        self._other_has_passed = other_has_passed
        self._now = now
        self._steps_left = STEPS_MAX

    def partner(self, place: Place, tolerance: int) -> Nearest | None:
        """What the first own item left gets; `other` has passed its time + tolerance. Raises Undecided."""
        end, other_end = LAST_PLACE, LAST_PLACE
        while True:
            near = self._other.nearest(place[0], tolerance, self._now, self._after, other_end)
            if near is None:
                return None
            end, paired = self._mutual(place, near, end, other_end)
            if end == place:
                return paired
            other_end = paired.time, paired.seq

    def _mutual(self, first: Place, near: Nearest, end: Place, other_end: Place) -> tuple[Place, Nearest]:
        """A pair below the ends of which each is the other's nearest, found by going from one to its nearest; or, when
        that takes too long, the pair that it began with."""
        one, begun = first, near
        while self._steps_left > 0:
            self._steps_left -= 1
            rival = self._rival(first, one, near, end)
            if rival == one:
                return one, near
            distance = abs(near.time - rival[0])
            if not self._other_has_passed(clamp(rival[0] + distance - 1)):
                raise Undecided
            nearer = self._other.nearest(rival[0], distance, self._now, self._after, other_end)
            if nearer is None or nearer[:2] == near[:2]:
                return rival, near
            one, near = rival, nearer
        return first, begun

    def _rival(self, first: Place, one: Place, near: Nearest, end: Place) -> Place:
        """The own item that is nearest to `near`; `one` is as near as told."""
        distance = abs(near.time - one[0])
        if not self._own_has_passed(clamp(near.time + distance - 1)):
            raise Undecided
        found = self._own.nearest(near.time, distance, self._now, first, end)
        return one if found is None else (found.time, found.seq)
