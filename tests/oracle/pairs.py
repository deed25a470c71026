"""The oracle's pairs of items: the nearest pairs first, each item in one pair at most, and no pair across another."""

from __future__ import annotations

from collections.abc import Iterable

ItemKey = tuple[int, int]


def paired(own: Iterable[ItemKey], other: Iterable[ItemKey], tolerance: int) -> dict[ItemKey, ItemKey]:
    """All pairs of items (time, seq) at most `tolerance` apart.

    Of equally near pairs, the pair with the earlier items wins.
    """
    possible = [(abs(one[0] - two[0]), one, two) for one in own for two in other if abs(one[0] - two[0]) <= tolerance]
    made: dict[ItemKey, ItemKey] = {}
    possible.sort(key=lambda pair: (pair[0], pair[1:]))
    for _, one, two in possible:
        if all(one != former and two != near and (one < former) == (two < near) for former, near in made.items()):
            made[one] = two
    return made
