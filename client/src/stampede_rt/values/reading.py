"""A read with the caller's arguments. The client turns it into a request. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Item
from stampede_rt.values.policy import flag_of, whole_number_of
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    DurationLike,
    InstantLike,
    Interval,
    Match,
    parse_duration,
    parse_instant,
)

TIMEOUT_S_MAX = 10**9  # a longer timeout counts as this one, about 32 years
SubscribeMode = Literal["all", "newest"]
"""A subscription delivers all items, or always the newest one."""
RENEW_S = 30.0  # the longest wait that one request asks for; for a longer wait the client sends several requests


@dataclass(frozen=True, slots=True)
class Wait:
    """The time that a call may wait: `seconds`, or without a limit if it is None."""

    seconds: float | None

    @classmethod
    def parse(cls, timeout: float | None) -> Wait:
        """Return the wait for a `timeout`: seconds, 0 or more, or None for no limit. Raises InvalidArgument."""
        if timeout is None:
            return cls(None)
        if isinstance(timeout, bool | str) or not isinstance(timeout, int | float) or not 0 <= timeout < math.inf:
            raise InvalidArgument(f"timeout is {timeout!r}; give seconds, 0 or more, or None to wait without a limit")
        return cls(min(timeout, TIMEOUT_S_MAX))

    def after(self, passed_s: float) -> Wait:
        """Return the rest of the wait after `passed_s` seconds, so that a repeated read does not wait longer."""
        return self if not self.seconds else Wait(max(self.seconds - passed_s, 0))

    @property
    def nanos(self) -> int:
        """Return the nanoseconds for the wire; -1 means no limit."""
        return -1 if self.seconds is None else round(self.seconds * 1e9)


NO_WAIT = Wait(0)


@dataclass(frozen=True, slots=True)
class ReadQuery:
    """One read of a channel (see `Channel.get`).

    - `after` is an item or an instant. The answer has only later items, or with `newest_first` only earlier ones.
    - `newer_than` is an item or an instant. The answer has only later items, even with `newest_first`.
    - `cut` is for reads through a group. The host reads at exactly this cut, which a host of the group gave before. If
      `cut` is None, the host reads at the present cut.
    - `max_staleness_nanos` and `least_seq`: the read accepts a copy that is at most this old, and that has the item of
      this seq. If both are None, it accepts no copy.
    - `as_of`: the answer is as of this instant of the host's clock, and `cut` is a cut at that instant.
    - `now`: in the request for a later page of an answer, the instant NOW of the first page.
    - `within_memory`: the read leaves out the items that only the archive of the channel has.
    """

    interval: Interval
    match: Match = Match.SPAN
    limit: int | None = None
    newest_first: bool = False
    after: Item | int | None = None
    newer_than: Item | int | None = None
    payloads: bool = True
    wait: Wait = NO_WAIT
    complete: bool = False
    cut: int | None = None
    max_staleness_nanos: int | None = None
    least_seq: int | None = None
    within_memory: bool = False
    as_of: int | None = None
    now: int | None = None

    def __post_init__(self) -> None:
        for what, value in (
            ("newest_first", self.newest_first), ("payloads", self.payloads), ("complete", self.complete),
        ):  # fmt: skip
            flag_of(what, value)


def parse_within(within: str | None) -> bool:
    """Return whether a read leaves out the archive. Raises InvalidArgument unless `within` is "memory" or None."""
    if within not in (None, "memory"):
        raise InvalidArgument(f'within is {within!r}; write "memory", or leave it out to read the archive, too')
    return within is not None


def parse_as_of(as_of: InstantLike | None) -> int | None:
    """Return `as_of` in nanoseconds; None for None. Raises InvalidArgument."""
    return None if as_of is None else parse_instant(as_of, "as_of")


def parse_replay(start: InstantLike, end: InstantLike | None, speed: float, step: bool) -> tuple[int, int, float]:
    """Return the first and the last instant of a replay, and its speed. Raises InvalidArgument."""
    first, last = parse_instant(start, "start"), MAX_INSTANT if end is None else parse_instant(end, "end")
    if last < first:
        raise InvalidArgument(f"end is {end!r}, before the start {start!r}; a replay goes forward")
    flag_of("step", step)
    if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0 <= speed < math.inf:
        raise InvalidArgument(f"speed is {speed!r}; write a number such as 2.0, or 0 for no pauses")
    return first, last, float(speed)


def parse_staleness(max_staleness: DurationLike | None) -> int | None:
    """Return `max_staleness` in nanoseconds; None for None. Raises InvalidArgument for a negative duration."""
    if max_staleness is None:
        return None
    nanos = parse_duration(max_staleness, "max_staleness")
    if nanos < 0:
        raise InvalidArgument(f'max_staleness is {max_staleness!r}; give "0s" or more, or None for the owner\'s answer')
    return nanos


def parse_least_seq(least_seq: int | None) -> int | None:
    """Return `least_seq`; None for None. Raises InvalidArgument for a number that no item can have as its seq."""
    if least_seq is None:
        return None
    seq = whole_number_of("least_seq", least_seq)
    if not 0 <= seq < 2**63:
        raise InvalidArgument(f"least_seq is {least_seq!r}; give the seq of an item")
    return seq


def after_position(after: Item | InstantLike) -> Item | int:
    """Return `after` as an item, or as an instant in nanoseconds."""
    return after if isinstance(after, Item) else parse_instant(after, "after")


def parse_limit(limit: int | None) -> int | None:
    """Return `limit`, the greatest number of items in an answer; None: all. Raises InvalidArgument."""
    if limit is None:
        return None
    count = whole_number_of("limit", limit)
    if not 1 <= count < 2**32:
        raise InvalidArgument(f"limit is {limit!r}; it must be 1 to {2**32 - 1}, or None for all")
    return count
