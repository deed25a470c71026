"""Runs of accepted items, which a channel stores, and slices of runs, which readers get. Pure.

A run is a producer's batch in columns. The producer encodes the batch, and the host keeps the encoded payloads as they
are (paper, section 4.1). A run of one item has a flat layout, because a channel may hold millions of such runs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple, Protocol

ABSENT = -1
"""The value for "no duration" in a column of durations."""

ITEM_OVERHEAD_BYTES = 64
"""The bytes that an item counts against max_bytes in addition to its payload."""


class Body(Protocol):
    """The encoded items of a run: bytes, or a `ReferencedBody`. `bytes(body)` gives the bytes."""

    def __len__(self) -> int: ...

    def __bytes__(self) -> bytes: ...


class ReferencedBody:
    """The body of a run of one item whose payload is the object that a program of this process put.

    `parts` are the encoded run, and `payload` is one of them. `bytes` joins them anew, for a reader in another process.
    `attributes` and `content_type` belong to the item.
    """

    __slots__ = ("_length", "attributes", "content_type", "parts", "payload")

    def __init__(
        self, parts: Sequence[bytes], payload: bytes, attributes: Mapping[str, str], content_type: str
    ) -> None:
        self.parts = parts
        self.payload = payload
        self.attributes = attributes
        self.content_type = content_type
        self._length = sum(map(len, parts))

    @property
    def payload_at(self) -> int:
        """Where the payload begins in the encoded run; 0 if the item has a content type, attributes or no payload."""
        if self.attributes or self.content_type or not self.payload:
            return 0
        return sum(map(len, takewhile(lambda part: part is not self.payload, self.parts)))

    def followed_by(self, part: bytes) -> ReferencedBody:
        """This body with one more part at its end."""
        return ReferencedBody((*self.parts, part), self.payload, self.attributes, self.content_type)

    def __len__(self) -> int:
        return self._length

    def __bytes__(self) -> bytes:
        return b"".join(self.parts)


class TimeSpan(NamedTuple):
    """The least and the greatest time of some items. `ascends`: no time is less than the time before it."""

    low: int
    high: int
    ascends: bool = True


def time_span(times: Sequence[int]) -> TimeSpan:
    """The span of one time or more. If the times ascend, sorting takes less time than `min` and `max`."""
    if len(times) == 1:
        return TimeSpan(times[0], times[0])
    values = [*times]
    ordered = sorted(values)
    return TimeSpan(ordered[0], ordered[-1], ordered == values)


class Run(ABC):
    """Accepted items in the order of acceptance; immutable. `first_seq` is the first item's seq, and each next item has
    the next seq.

    `times` are in nanoseconds since the epoch, in any order. `durations` are in nanoseconds, -1 for none, or None if no
    item has one. `lengths` are in bytes of payload. `body` holds the bytes that the `Seal` returned.
    """

    __slots__ = ("body", "first_seq")

    first_seq: int
    body: Body

    @property
    @abstractmethod
    def times(self) -> Sequence[int]:
        """Each item's time."""

    @property
    @abstractmethod
    def durations(self) -> Sequence[int] | None:
        """Each item's duration, -1 for none; None if no item has one."""

    @property
    @abstractmethod
    def lengths(self) -> Sequence[int]:
        """Each item's payload length."""

    @property
    @abstractmethod
    def span(self) -> TimeSpan:
        """The span of its times."""

    @abstractmethod
    def payload_bytes(self, lo: int, hi: int) -> int:
        """The payload bytes of the items from position `lo` up to `hi`, exclusive."""

    def __len__(self) -> int:
        return len(self.lengths)


class Slicer(Protocol):
    """Cuts parts out of a run's body. The shell of channels makes the slicer when a reader first needs a part."""

    def cut(self, lo: int, hi: int, *, without_payloads: bool) -> bytes:
        """The body of the items from position `lo` up to `hi`, exclusive."""

    def plain_payload(self, at: int) -> bytes | None:
        """The payload of the item at a position; None if the run has a content type or attributes."""


class ColumnRun(Run):
    """A run of any number of items.

    `kept` is the number of its items that are in the index, because they are held or not freed yet. The shell of
    channels keeps the run's `slicer` here, so that it parses the body once. `whole_bytes` is the sum of `lengths`;
    -1: it is not known, because `lengths` may still grow.
    """

    __slots__ = ("_span", "durations", "kept", "lengths", "slicer", "times", "whole_bytes")

    def __init__(
        self, first_seq: int, times: Sequence[int], durations: Sequence[int] | None, lengths: Sequence[int], body: Body,
        span: TimeSpan | None = None,
    ) -> None:  # fmt: skip
        """`span`: the span of `times`, if the caller knows it."""
        self.first_seq = first_seq
        self.times: Sequence[int] = times
        self.durations: Sequence[int] | None = durations
        self.lengths: Sequence[int] = lengths
        self.body = body
        self.kept = 0
        self.slicer: Slicer | None = None
        self.whole_bytes = -1
        self._span = span

    @property
    def span(self) -> TimeSpan:
        """The span of its times. The run stores the span, so the caller must add no more items afterwards."""
        if self._span is None:
            self._span = time_span(self.times)
        return self._span

    def payload_bytes(self, lo: int, hi: int) -> int:
        """The payload bytes of the items from position `lo` up to `hi`, exclusive."""
        is_known = self.whole_bytes >= 0 and lo == 0 and hi == len(self.lengths)
        return self.whole_bytes if is_known else sum(self.lengths[lo:hi])

    def part(self, lo: int, hi: int, body: Body) -> ColumnRun:
        """The items from position `lo` up to `hi`, exclusive, as a run of their own."""
        durations = None if self.durations is None else self.durations[lo:hi]
        run = ColumnRun(self.first_seq + lo, self.times[lo:hi], durations, self.lengths[lo:hi], body)
        run.kept = hi - lo
        return run


class SingleItemRun(Run):
    """A run of one item. It has all attributes of an index entry, so it needs no separate entry."""

    __slots__ = ("duration", "first_time", "length")

    lo = 0
    hi = 1

    def __init__(self, first_seq: int, time: int, duration: int, length: int, body: Body) -> None:
        self.first_seq = first_seq
        self.first_time = time
        self.duration = duration
        self.length = length
        self.body = body

    @property
    def run(self) -> Run:
        """This object: it is both the index entry and the run of that entry."""
        return self

    @property
    def last_time(self) -> int:
        """The only item's time."""
        return self.first_time

    @property
    def times(self) -> Sequence[int]:
        """The item's time."""
        return (self.first_time,)

    @property
    def durations(self) -> Sequence[int] | None:
        """The item's duration, or None."""
        return None if self.duration == ABSENT else (self.duration,)

    @property
    def lengths(self) -> Sequence[int]:
        """The item's payload length."""
        return (self.length,)

    @property
    def span(self) -> TimeSpan:
        """The span of one time."""
        return TimeSpan(self.first_time, self.first_time)

    def payload_bytes(self, lo: int, hi: int) -> int:
        """The item's payload length, if the item lies between the two positions; otherwise 0."""
        return self.length if lo < hi else 0

    def __len__(self) -> int:
        return 1


def make_run(
    first_seq: int, times: Sequence[int], durations: Sequence[int] | None, lengths: Sequence[int], body: Body,
    span: TimeSpan | None = None,
) -> Run:  # fmt: skip
    """A run in its smallest layout. Copies the columns. `span`: the span of `times`, if the caller knows it."""
    if len(lengths) == 1:
        return SingleItemRun(first_seq, times[0], ABSENT if durations is None else durations[0], lengths[0], body)
    run = ColumnRun(first_seq, pack(times), None if durations is None else pack(durations), pack(lengths), body, span)
    run.whole_bytes = sum(lengths)
    return run


def pack(column: Sequence[int]) -> Sequence[int]:
    """A copy of a column, as an array with 8 bytes for each entry."""
    return array("q", column)


class Slice(NamedTuple):
    """The items of a run from position `lo` up to `hi`, exclusive. A value that is safe to keep and send later.

    The items of a slice in an answer or delivery ascend in (time, seq).
    """

    run: Run
    lo: int
    hi: int

    @property
    def is_whole(self) -> bool:
        """Whether the slice covers the whole run, so that the run's body can be sent as it is."""
        return self.hi - self.lo == len(self.run)

    @property
    def first_seq(self) -> int:
        """The seq of the first item."""
        return self.run.first_seq + self.lo

    @property
    def end_seq(self) -> int:
        """The seq after the last item's seq."""
        return self.run.first_seq + self.hi

    @property
    def first_time(self) -> int:
        """The time of the first item."""
        return self.run.times[self.lo]

    @property
    def last_time(self) -> int:
        """The time of the last item."""
        return self.run.times[self.hi - 1]

    @property
    def items(self) -> int:
        """The number of items."""
        return self.hi - self.lo

    @property
    def payload_bytes(self) -> int:
        """The payload bytes of its items."""
        return self.run.payload_bytes(self.lo, self.hi)

    @property
    def charge_bytes(self) -> int:
        """The bytes that its items cost a reader's credit."""
        return self.payload_bytes + self.items * ITEM_OVERHEAD_BYTES

    def within(self, credit_bytes: int) -> Slice:
        """The first items of the slice, each of which begins while some credit is left. Always has the first item."""
        if self.charge_bytes <= credit_bytes:
            return self
        left, at = credit_bytes, self.lo
        for length in self.run.lengths[self.lo : self.hi]:
            at += 1
            left -= length + ITEM_OVERHEAD_BYTES
            if left <= 0:
                break
        return Slice(self.run, self.lo, at)
