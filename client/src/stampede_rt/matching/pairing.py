"""Pairs the items of two channels so that no item is in two pairs: nearest pairs first (decision 0073). Pure.

The first pair is the one with the least distance in time, at most the tolerance. Then the same rule pairs the items
before both items of this pair, and the items after both. Of equally near pairs, the pair with the earlier items comes
first. So pairs do not cross: a later item has a later partner.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from stampede_rt.matching.item_keys import FIRST_KEY, LAST_KEY, ItemKey
from stampede_rt.values.timeline import clamp

STEPS_MAX = 16
"""The most steps of the chain that a `Pairing` follows."""

HasPassed = Callable[[int], bool]
"""Returns True if a channel can get no more items up to the given instant, inclusive."""


class PartnerUndecided(Exception):
    """Raised while an item that has not come yet may change the partner."""


class PlacedItem(Protocol):
    """A found item: its place among the items of its channel."""

    @property
    def time(self) -> int:
        """The time of the item."""

    @property
    def seq(self) -> int:
        """The seq of the item."""


Found = TypeVar("Found", bound=PlacedItem, covariant=True)


class SearchedItems(Protocol[Found]):
    """The items of one channel, among which a pairing searches (see the `Track` of a host)."""

    def nearest(
        self, time: int, tolerance: int, now: int, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY
    ) -> Found | None:
        """The nearest item from `low` on and below `high`, at most `tolerance` from `time`; None if there is none."""


class Pairing(Generic[Found]):
    """Pairs `own` items, in time order, with `other` items at or above `after`.

    An item does not get the `other` item that is nearest to it if a later `own` item is nearer to that item. The later
    item depends on another item in the same way, at a smaller distance, and so on. The pairing follows this chain for
    STEPS_MAX steps. If the chain is longer, the item gets the nearest item that is left. `looks` counts the searches
    for a nearest item.
    """

    def __init__(
        self,
        own: SearchedItems[PlacedItem],
        other: SearchedItems[Found],
        after: ItemKey,
        own_has_passed: HasPassed,
        other_has_passed: HasPassed,
        now: int,
    ) -> None:
        self._own = own
        self._other = other
        self._after = after
        self._own_has_passed = own_has_passed
        self._other_has_passed = other_has_passed
        self._now = now
        self.looks = 0

    def partner(self, key: ItemKey, tolerance: int) -> Found | None:
        """The partner of `key`, the first unpaired own item; None if it has none.

        `other` must have passed the item's time + tolerance. Raises PartnerUndecided if an item that has not come yet
        may change the partner.
        """
        # Only items below these keys may be paired: when a pair is found, the items after it do not count any more.
        end, other_end = LAST_KEY, LAST_KEY
        # Own items, each with the greatest distance of its partner. Each item is nearer than the item before it to the
        # other item that both could get.
        chain = [(key, tolerance)]
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
                raise PartnerUndecided
            chain.append((rival, distance))
        return self._other.nearest(key[0], tolerance, self._now, self._after, other_end)

    def _rival(self, first: ItemKey, one: ItemKey, near: PlacedItem, end: ItemKey) -> ItemKey:
        """The own item from `first` on that is nearest to `near`. `one` is the own item for which `near` was found."""
        distance = abs(near.time - one[0])
        if not self._own_has_passed(clamp(near.time + distance - 1)):
            raise PartnerUndecided
        found = self._own.nearest(near.time, distance, self._now, first, end)
        return one if found is None else (found.time, found.seq)
