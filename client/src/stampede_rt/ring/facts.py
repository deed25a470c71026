"""Computes from the facts of a ring: the host's clock, and whether the channel surely holds an item. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.ring.layout import (
    CLOCK_BOOTTIME,
    CLOCK_HOST,
    CLOCK_OFFSET,
    FLOOR_SEQ,
    FLOOR_TIME,
    MAX_AGE,
    NEWEST_SLOT,
    NEWEST_TIME,
)

CATCH_UP_NANOS = 30_000_000_000  # the host's clock makes up for its offset in this time, see HostTime
AGE_MARGIN_NANOS = 1_000_000  # a reader asks the host about an item that is this close to the age limit


def host_now(facts: Sequence[int], boottime: int) -> int:
    """Return the host's clock at `boottime`, a reading of CLOCK_BOOTTIME on the same machine."""
    elapsed = max(0, boottime - facts[CLOCK_BOOTTIME])
    offset = facts[CLOCK_OFFSET]
    made_up = min(abs(offset) * elapsed // CATCH_UP_NANOS, abs(offset), elapsed // 2)
    return facts[CLOCK_HOST] + elapsed + (made_up if offset > 0 else -made_up)


def age_bound(facts: Sequence[int], now: int) -> int | None:
    """Return the instant after which no item can be too old at `now`; None if the channel has no limit of age."""
    age = facts[MAX_AGE]
    return None if age < 0 else now - age + AGE_MARGIN_NANOS


def surely_held(facts: Sequence[int], time: int, seq: int, aged: int | None) -> bool:
    """Whether the channel surely holds the item. `aged`: see `age_bound`. The newest bucket never grows too old."""
    if (time, seq) < (facts[FLOOR_TIME], facts[FLOOR_SEQ]):
        return False
    return aged is None or time > aged or (facts[NEWEST_SLOT] >= 0 and time == facts[NEWEST_TIME])
