"""Instants, durations, bounds and intervals (paper, sections 3.1 and 3.2). Pure.

Instants are int nanoseconds since the Unix epoch, UTC; durations are int nanoseconds. An interval is a part of
continuous time, although its bounds are whole nanoseconds. The interval `(10, 11)` is therefore not empty. The interval
`[10, 10)` is empty.
"""

from __future__ import annotations

import operator
import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from enum import Enum
from itertools import pairwise
from typing import Literal

from stampede_rt.errors import InvalidArgument, InvalidInterval

MIN_INSTANT = -(2**63)
MAX_INSTANT = 2**63 - 1

_UNITS_NANOS = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "m": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}
_DURATION = re.compile(r"([+-]?\d+(?:\.\d+)?) ?(ns|us|ms|s|m|h|d)")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

DurationLike = str | timedelta
"""A length of time: "30ms", "1.5 s" or a timedelta."""
InstantLike = int | datetime
"""An instant: int nanoseconds since the epoch, or a datetime with a timezone."""
Bounds = Literal["[]", "[)", "(]", "()"]
"""Says which bounds belong to the interval: a bracket means an inclusive bound, a parenthesis an exclusive
one."""


def parse_duration(value: DurationLike, what: str = "a duration") -> int:
    """Return the nanoseconds of `"30ms"`, `"1.5 s"` or a timedelta. Units: ns, us, ms, s, m, h, d.

    Raises InvalidArgument for a number without a unit, such as `max_age=10`, and for lengths of more than about 292
    years, which do not fit into 64 bits. `what` names the argument in the error's text.
    """
    nanos = _nanos_of(value) if isinstance(value, timedelta) else _read_duration(value, what)
    if not MIN_INSTANT <= nanos <= MAX_INSTANT:
        raise InvalidArgument(f"{what} is {value!r}; a duration is less than 292 years")
    return nanos


def _nanos_of(value: timedelta) -> int:
    return (value.days * 86_400 + value.seconds) * 1_000_000_000 + value.microseconds * 1_000


def _read_duration(value: str, what: str) -> int:
    if not isinstance(value, str):
        raise InvalidArgument(f'{what} is {value!r}; write it with its unit, such as "30ms", or as a timedelta')
    match = _DURATION.fullmatch(value.strip())
    if match is None:
        raise InvalidArgument(f'{what} is {value!r}; write a number and one of ns, us, ms, s, m, h, d, such as "30ms"')
    nanos = Decimal(match[1]) * _UNITS_NANOS[match[2]]
    if nanos != nanos.to_integral_value():
        raise InvalidArgument(f"{what} is {value!r}, which is not a whole number of nanoseconds")
    return int(nanos)


def parse_item_duration(value: DurationLike | int | None) -> int | None:
    """Return the nanoseconds of an item's duration; None if `value` is None.

    Unlike `parse_duration`, takes an int as nanoseconds, so that a caller can write `duration=item.duration`. Raises
    InvalidArgument, also for a negative duration.
    """
    if value is None:
        return None
    nanos = value if type(value) is int else parse_duration(_no_bool(value), "an item's duration")
    if not 0 <= nanos <= MAX_INSTANT:
        raise InvalidArgument(f"an item's duration is {value!r}; it is 0 or more, and less than 292 years")
    return nanos


INSTANT_FORMS = "int nanoseconds since the epoch or a datetime with a timezone"
BOUND_FORMS = f'{INSTANT_FORMS}, or NOW, NEWEST or OLDEST, as in NOW - "5s"'


def parse_instant(value: InstantLike, what: str = "a time", forms: str = INSTANT_FORMS) -> int:
    """Return an instant as int nanoseconds since the epoch. `value` is such an int, or a datetime with a timezone.

    `forms` names the allowed values in error texts. Raises InvalidArgument for another type, for a datetime without a
    timezone, and for an instant that does not fit into 64 bits.
    """
    if type(value) is int and MIN_INSTANT <= value <= MAX_INSTANT:
        return value
    if isinstance(value, datetime):
        if value.utcoffset() is None:
            shown = value.isoformat()
            raise InvalidArgument(f"{what} is {shown} without a timezone; give it one, as in datetime.now(UTC)")
        return _in_range(_nanos_of(value - _EPOCH), value, what)
    if isinstance(value, bool | float | str):
        raise InvalidArgument(f"{what} is {value!r}; give {forms}")
    try:
        instant = operator.index(value)
    except TypeError:
        raise InvalidArgument(f"{what} is {value!r}; give {forms}") from None
    return _in_range(instant, value, what)


def _in_range(instant: int, value: InstantLike, what: str) -> int:
    if not MIN_INSTANT <= instant <= MAX_INSTANT:
        raise InvalidArgument(f"{what} is {value!r}, which does not fit into 64 bits of nanoseconds")
    return instant


def _no_bool(value: DurationLike | int) -> DurationLike:
    """Return `value`, or, if it is a bool or another number, a text that `parse_duration` refuses."""
    return value if isinstance(value, str | timedelta) else str(value)


def format_duration(nanos: int) -> str:
    """Return `nanos` as a text for people, such as "1.5 s" or "30 ms".

    Rounds to thousandths of the unit. If that gives a whole larger unit, returns the larger unit: "1 h", not "60 m".
    """
    for unit, smaller in pairwise(("d", "h", "m", "s", "ms", "us", "ns")):
        if abs(nanos) + _UNITS_NANOS[smaller] // 2000 >= _UNITS_NANOS[unit]:
            return f"{round(nanos / _UNITS_NANOS[unit], 3):g} {unit}"
    return f"{nanos} ns" if nanos else "0 s"


def format_instant(instant: int) -> str:
    """Return `instant` as ISO 8601 in UTC with nanoseconds. Outside the years 1 to 9999 return "`instant` ns"."""
    seconds, nanos = divmod(instant, 1_000_000_000)
    try:
        return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}.{nanos:09d}Z"
    except OverflowError:
        return f"{instant} ns"


def clamp(instant: int) -> int:
    """Return `instant`, or the nearest instant that fits into int64."""
    return max(MIN_INSTANT, min(MAX_INSTANT, instant))


class MetaTime(Enum):
    """A time that the host resolves when it performs the read: NOW, NEWEST or OLDEST (paper, section 3.2)."""

    NOW = "now"
    NEWEST = "newest"
    OLDEST = "oldest"


@dataclass(frozen=True, slots=True)
class Bound:
    """An end of an interval: a meta-time plus `offset` nanoseconds, or the instant `offset` if `meta` is None."""

    meta: MetaTime | None
    offset: int = 0

    def __add__(self, offset: DurationLike) -> Bound:
        return replace(self, offset=clamp(self.offset + parse_duration(offset, "an offset")))

    def __sub__(self, offset: DurationLike) -> Bound:
        return replace(self, offset=clamp(self.offset - parse_duration(offset, "an offset")))

    def __str__(self) -> str:
        if self.meta is None:
            return format_instant(self.offset)
        if not self.offset:
            return self.meta.value
        return f"{self.meta.value} {'+' if self.offset > 0 else '-'} {format_duration(abs(self.offset))}"


NOW = Bound(MetaTime.NOW)
NEWEST = Bound(MetaTime.NEWEST)
OLDEST = Bound(MetaTime.OLDEST)

BoundLike = Bound | InstantLike
"""A bound of an interval: an instant, or NOW, NEWEST or OLDEST, with or without an offset."""


def parse_bound(value: BoundLike, what: str = "a bound") -> Bound:
    """Return `value` as a bound. Raises InvalidArgument if `value` is neither a bound nor an instant."""
    return value if isinstance(value, Bound) else Bound(None, parse_instant(value, what, BOUND_FORMS))


def last(duration: DurationLike) -> tuple[Bound, Bound]:
    """Return the bounds NOW - `duration` and NOW, as in `channel.get(*last("30s"))`.

    Raises InvalidArgument for a negative duration.
    """
    if parse_duration(duration, "the duration") < 0:
        raise InvalidArgument(f"the duration is {duration!r}; it reaches back from now: leave the minus out")
    return NOW - duration, NOW


@dataclass(frozen=True, slots=True)
class ResolvedInterval:
    """An interval whose bounds are instants: the host has resolved all meta-times."""

    start: int
    end: int
    start_exclusive: bool = False
    end_exclusive: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether the interval contains no time at all."""
        return self.start > self.end or (self.start == self.end and (self.start_exclusive or self.end_exclusive))

    def __contains__(self, instant: int) -> bool:
        above = instant > self.start or (instant == self.start and not self.start_exclusive)
        return above and (instant < self.end or (instant == self.end and not self.end_exclusive))


@dataclass(frozen=True, slots=True)
class Interval:
    """Two bounds, each inclusive or exclusive. The host resolves both at the same moment."""

    start: Bound
    end: Bound
    start_exclusive: bool = False
    end_exclusive: bool = False

    def __post_init__(self) -> None:
        if self.start.meta is None and self.end.meta is None and self.start.offset > self.end.offset:
            raise InvalidInterval(
                f"the interval starts at {self.start} ({self.start.offset}), after its end at {self.end} "
                f"({self.end.offset}); swap the two"
            )

    @property
    def needs_items(self) -> bool:
        """Whether a bound is NEWEST or OLDEST. An empty channel has no such times."""
        return not {self.start.meta, self.end.meta}.isdisjoint({MetaTime.NEWEST, MetaTime.OLDEST})

    def resolve(self, *, now: int, newest: int | None, oldest: int | None) -> ResolvedInterval | None:
        """Return the interval at the host's time `now`, with the times of the newest and the oldest item.

        Returns None if a bound is NEWEST or OLDEST and the channel has no items.
        """
        if self.start.meta is None and self.end.meta is None:
            start, end = self.start.offset, self.end.offset
        elif self.needs_items and (newest is None or oldest is None):
            return None
        else:
            anchors = {None: 0, MetaTime.NOW: now, MetaTime.NEWEST: newest or 0, MetaTime.OLDEST: oldest or 0}
            start, end = anchors[self.start.meta] + self.start.offset, anchors[self.end.meta] + self.end.offset
        return ResolvedInterval(clamp(start), clamp(end), self.start_exclusive, self.end_exclusive)


def fixed(interval: Interval, resolved: ResolvedInterval | None) -> Interval:
    """Return `interval` with the instants to which a host has resolved its bounds.

    With it, a repeated read has the same bounds as the first read. Returns `interval` itself if the host could not
    resolve it (`resolved` is None), or has resolved its start to an instant after its end.
    """
    if resolved is None or resolved.start > resolved.end:
        return interval
    ends = Bound(None, resolved.start), Bound(None, resolved.end)
    return Interval(*ends, interval.start_exclusive, interval.end_exclusive)


_BOUNDS = {"[]": (False, False), "[)": (False, True), "(]": (True, False), "()": (True, True)}


def parse_interval(start: BoundLike, end: BoundLike, bounds: str = "[]") -> Interval:
    """Return the interval between `start` and `end`; `bounds` is one of "[]", "[)", "(]", "()".

    Raises InvalidArgument, and InvalidInterval if both bounds are instants and `start` is later than `end`.
    """
    if bounds not in _BOUNDS:
        raise InvalidArgument(f'bounds is {bounds!r}; write one of "[]", "[)", "(]", "()"')
    return Interval(
        parse_bound(start, "the interval's start"), parse_bound(end, "the interval's end"), *_BOUNDS[bounds]
    )


ALL_TIME = parse_interval(MIN_INSTANT, MAX_INSTANT)
"""The interval that holds every instant."""


class Match(Enum):
    """The rule by which an interval selects items (paper, section 3.2)."""

    SPAN = "span"  # items whose span shares an instant with the interval
    WHOLE = "whole"  # items whose whole span is in the interval
    START = "start"  # items whose time is in the interval


MatchLike = Literal["span", "whole", "start"] | Match
"""The rule by which an interval selects items, or the name of the rule."""


def parse_match(value: str | Match) -> Match:
    """Return the rule that `value` names; a rule itself is returned as it is. Raises InvalidArgument."""
    try:
        return Match(value)
    except ValueError:
        raise InvalidArgument(f'match is {value!r}; write one of "span", "whole", "start"') from None
