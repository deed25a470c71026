"""The bounds of the times of messages in a part of a file. Pure."""

from __future__ import annotations

TimeBounds = tuple[int | None, int | None]
"""The least and the greatest time of messages, in nanoseconds since the epoch; None: not known."""


def known_times(least: int, greatest: int) -> TimeBounds:
    """Return the bounds of the times of items, as far as the least and the greatest log time of a chunk show them.

    The log time 0 says nothing: items from before 1970 and chunks without messages have it.
    """
    return (least or None, greatest or None) if least <= greatest else (None, None)


def joined_times(one: TimeBounds, other: TimeBounds) -> TimeBounds:
    """Return the bounds of the times of two parts of a file together."""
    least = None if one[0] is None or other[0] is None else min(one[0], other[0])
    greatest = None if one[1] is None or other[1] is None else max(one[1], other[1])
    return least, greatest
