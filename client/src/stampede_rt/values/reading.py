"""A read as its caller stated it, before it becomes a request. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Item
from stampede_rt.values.policy import flag_of, whole_number_of
from stampede_rt.values.timeline import InstantLike, Interval, Match, parse_instant

TIMEOUT_S_MAX = 10**9
SubscribeMode = Literal["all", "newest"]
"""What a subscription delivers: every item, or the latest one, never going back."""
RENEW_S = 30.0  # a wait without limit asks again so often


@dataclass(frozen=True, slots=True)
class Wait:
    """How long a call may wait: `seconds`, None for ever."""

    seconds: float | None

    @classmethod
    def parse(cls, timeout: float | None) -> Wait:
        """A timeout in seconds, 0 or more; None: for ever."""
        if timeout is None:
            return cls(None)
        if isinstance(timeout, bool | str) or not isinstance(timeout, int | float) or not 0 <= timeout < math.inf:
            raise InvalidArgument(f"timeout is {timeout!r}; give seconds, 0 or more, or None to wait for ever")
        return cls(min(timeout, TIMEOUT_S_MAX))

    def after(self, passed_s: float) -> Wait:
        """What is left of it; a read that is tried again does not wait anew."""
        return self if not self.seconds else Wait(max(self.seconds - passed_s, 0))

    @property
    def nanos(self) -> int:
        """As the wire has it: -1 stands for ever."""
        return -1 if self.seconds is None else round(self.seconds * 1e9)


NO_WAIT = Wait(0)


@dataclass(frozen=True, slots=True)
class ReadQuery:
    """One read of a channel (see `Channel.get`). Positions are an item or the instant behind whose items to go on.

    `cut`: through a group at exactly this cut, which one of its hosts gave; None: the cut of the moment.
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

    def __post_init__(self) -> None:
        for what, value in (
            ("newest_first", self.newest_first), ("payloads", self.payloads), ("complete", self.complete),
        ):  # fmt: skip
            flag_of(what, value)


def after_position(after: Item | InstantLike) -> Item | int:
    """An item as it is, or an instant."""
    return after if isinstance(after, Item) else parse_instant(after, "after")


def parse_limit(limit: int | None) -> int | None:
    """How many items at most; None: all."""
    if limit is None:
        return None
    count = whole_number_of("limit", limit)
    if not 1 <= count < 2**32:
        raise InvalidArgument(f"limit is {limit!r}; it must be 1 or more, or None for all")
    return count
