"""Items that are kept in columns. An Item is made when a program touches it. Pure."""

from __future__ import annotations

import struct
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, repeat
from operator import lt
from typing import Any, overload

from stampede_rt.values.answers import ABSENT, COLUMN_TYPES, read_only
from stampede_rt.values.model import Item

Payloads = bytes | memoryview | list[bytes] | None
SHORT_BYTES = 1024  # payloads that are shorter on average stay together in one copy; see `kept`


@dataclass(slots=True)
class DecodedRun:
    """The columns of one run. Each has an entry for each item.

    `durations` has -1 for no duration; None: no item has one. `attributes` and `content_type` belong to all items.
    `payloads` has the payloads one after the other, or a list of them; None: the read was without payloads, or all
    items are made, and each keeps its own payload. `next_time` is the time of the bucket after the run; None: the next
    run begins that bucket, or the run has the newest bucket.

    If `payloads` is a view, call `kept` immediately, because other data will overwrite the memory of the view.
    """

    times: Sequence[int]
    durations: Sequence[int] | None
    lengths: Sequence[int]
    first_seq: int
    attributes: dict[str, str]
    content_type: str
    incarnation: int
    payloads: Payloads
    next_time: int | None = None

    @property
    def seqs(self) -> range:
        """The items' seqs."""
        return range(self.first_seq, self.first_seq + len(self.lengths))


class ItemColumns(Sequence[Item]):
    """The items of runs that follow each other in time. This sequence makes an item when a program first touches the
    item, and keeps it.

    Several threads may read the sequence at the same time.
    """

    def __init__(
        self,
        runs: Sequence[DecodedRun],
        *,
        overlap: int,
        make: Callable[[Iterable[Any]], Item] | None = None,
        backwards: bool = False,
    ) -> None:
        """`make` makes an item of its fields; None: a plain Item.

        `overlap`: during the first `overlap` nanoseconds of the span of an item with a duration, no later item ends it.
        `backwards`: the items come in reverse order.
        """
        self._runs = runs
        self._overlap = overlap
        self._make = make
        self._backwards = backwards
        self._begins = [*accumulate((len(run.lengths) for run in runs), initial=0)]
        self._whole: list[list[Item] | None] = [None] * len(runs)  # for each run all its items; None: not made yet
        self._touched: dict[int, Item] = {}  # single items of other runs
        self._ends: list[int | None] | None = None

    def __len__(self) -> int:
        return self._begins[-1]

    def __reduce__(self) -> tuple[type[list[Item]], tuple[list[Item]]]:
        return list, ([*self],)

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        places = range(len(self))[:: -1 if self._backwards else 1][index]  # raises IndexError as a list does
        if isinstance(places, int):
            return self._at(places)
        return [*self][index] if 2 * len(places) > len(self) else [self._at(at) for at in places]

    def __iter__(self) -> Iterator[Item]:
        if self._backwards:
            for number in reversed(range(len(self._runs))):
                yield from reversed(self._of_run(number))
        else:
            for number in range(len(self._runs)):
                yield from self._of_run(number)

    def column(self, name: str) -> memoryview:
        """Return a column: "time", "duration" (-1: none) or "seq" of each item, in the order of the items."""
        column = array(COLUMN_TYPES[name])
        for run in self._runs:
            column.extend(_entries(run, name))
        return read_only(column[::-1] if self._backwards else column)

    def payload_list(self) -> list[bytes | None]:
        """Return the payload of each item, in the order of the items. Makes no items."""
        found: list[bytes | None] = []
        for number, run in enumerate(self._runs):
            # The payloads first: another thread in `_of_run` sets `_whole`, and only then drops the payloads.
            payloads, whole = run.payloads, self._whole[number]
            found += _each_payload(payloads, run.lengths) if whole is None else (item.payload for item in whole)
        return found[::-1] if self._backwards else found

    @property
    def payload_bytes(self) -> int:
        """The length of all payloads together, also in reads without payloads."""
        return sum(sum(run.lengths) for run in self._runs)

    def _at(self, at: int) -> Item:
        number = bisect_right(self._begins, at) - 1
        place, run = at - self._begins[number], self._runs[number]
        # The payloads first: another thread in `_of_run` sets `_whole`, and only then drops the payloads.
        payloads, whole = run.payloads, self._whole[number]
        if whole is not None:
            return whole[place]
        item = self._touched.get(at)
        if item is None:
            begin = sum(run.lengths[:place])
            duration = ABSENT if run.durations is None else run.durations[place]
            fields = (
                run.times[place],
                self._all_ends()[at],
                None if duration < 0 else duration,
                run.first_seq + place,
                _payload_at(payloads, place, begin, run.lengths[place]),
                run.attributes,
                run.content_type,
                run.lengths[place],
                run.incarnation,
            )
            item = self._touched.setdefault(at, (self._make or Item._make)(fields))
        return item

    def _of_run(self, number: int) -> list[Item]:
        payloads, whole = self._runs[number].payloads, self._whole[number]
        if whole is not None:
            return whole
        whole = self._make_all(number, payloads)
        for at in [at for at in [*self._touched] if self._begins[number] <= at < self._begins[number + 1]]:
            whole[at - self._begins[number]] = self._touched.pop(at)
        self._whole[number] = whole
        self._runs[number].payloads = None  # each item has its own payload
        return whole

    def _make_all(self, number: int, payloads: Payloads) -> list[Item]:
        ends = self._all_ends()[self._begins[number] : self._begins[number + 1]]
        return _made(self._runs[number], payloads, ends, self._make)

    def _all_ends(self) -> list[int | None]:
        if self._ends is None:
            ends: list[int | None] = []
            begin = 0
            for at, run in enumerate(self._runs, 1):
                if run.next_time is not None or at == len(self._runs):
                    ends += _ends_of(self._runs[begin:at], self._overlap)
                    begin = at
            self._ends = ends
        return self._ends


def kept(run: DecodedRun) -> DecodedRun:
    """Copy the payloads of a run, if they are a view. Short ones stay together, and are copied again when a program
    touches them. Returns the run."""
    if isinstance(run.payloads, memoryview):
        is_short = len(run.payloads) < SHORT_BYTES * len(run.lengths)
        run.payloads = bytes(run.payloads) if is_short else [*_split(run.payloads, run.lengths)]
    return run


def _made(
    run: DecodedRun,
    payloads: Payloads,
    ends: Sequence[int | None],
    make: Callable[[Iterable[Any]], Item] | None,
) -> list[Item]:
    split = _each_payload(payloads, run.lengths)
    given: Iterable[int | None] = repeat(None)
    if run.durations is not None:
        given = [None if duration < 0 else duration for duration in run.durations]
    labels = repeat(run.attributes), repeat(run.content_type), run.lengths, repeat(run.incarnation)
    rows = zip(run.times, ends, given, run.seqs, split, *labels)  # noqa: B905 - some columns are endless
    if make is not None:
        return [*map(make, rows)]
    return [*map(tuple.__new__, repeat(Item), rows)]  # as Item._make does, but without a Python call for each item


def _each_payload(payloads: Payloads, lengths: Sequence[int]) -> Iterable[bytes | None]:
    if payloads is None:
        return repeat(None, len(lengths))
    return payloads if isinstance(payloads, list) else _split(payloads, lengths)


def _payload_at(payloads: Payloads, place: int, begin: int, length: int) -> bytes | None:
    if payloads is None:
        return None
    return payloads[place] if isinstance(payloads, list) else bytes(payloads[begin : begin + length])


def _split(payloads: bytes | memoryview, lengths: Sequence[int]) -> Iterable[bytes]:
    """Return a copy of each payload."""
    if len(lengths) == 1:
        return (bytes(payloads),)  # bytes stay the same object
    length = lengths[0]
    if len(lengths) == lengths.count(length):  # the usual case, at a quarter of the time
        return struct.unpack(f"{length}s" * len(lengths), payloads)
    ends = [*accumulate(lengths, initial=0)]
    places = map(slice, ends, ends[1:])
    if isinstance(payloads, bytes) or len(payloads) < SHORT_BYTES * len(lengths):
        cut: Callable[[slice], bytes] = bytes(payloads).__getitem__  # Python cuts bytes faster than a view
        return map(cut, places)
    return map(bytes, map(payloads.__getitem__, places))


def _ends_of(runs: Sequence[DecodedRun], overlap: int) -> list[int | None]:
    """Return the ends of the spans of all items. Only the last run may have a `next_time`."""
    times = [time for run in runs for time in run.times]
    durations = None
    if any(run.durations for run in runs):
        durations = [entry for run in runs for entry in _entries(run, "duration")]
    return span_ends(times, durations, runs[-1].next_time, overlap)


def _entries(run: DecodedRun, name: str) -> Sequence[int]:
    if name == "seq":
        return run.seqs
    if name == "time":
        return run.times
    return run.durations if run.durations is not None else (ABSENT,) * len(run.lengths)


def span_ends(
    times: Sequence[int], durations: Sequence[int] | None, next_time: int | None, overlap: int
) -> list[int | None]:
    """Return the end of the span of each item; None for a span without an end.

    The next item in the list ends a span only if its time is later. A run of late items may be out of order.
    """
    following, bucket = next_time, None
    if not overlap and (following is None or following > times[-1]):
        starts: list[int | None] | None = None
        if len(times) == times.count(times[0]):  # all items have one time, as when the host stamped them
            starts = [following] * len(times)
        elif all(map(lt, times, times[1:])):
            starts = [*times[1:], following]  # each next item ends a span
        if starts is not None:  # the usual cases, at a third of the time
            return starts if durations is None else [*map(_earlier, times, durations, starts)]
    ends: list[int | None] = []
    for time, duration in zip(reversed(times), reversed(durations or (ABSENT,) * len(times)), strict=True):
        if bucket is not None and bucket > time:
            following = bucket
        bucket = time
        ends.append(span_end(time, duration, following if following is None or following > time else None, overlap))
    ends.reverse()
    return ends


def _earlier(time: int, duration: int, next_time: int | None) -> int | None:
    own = time + duration
    return next_time if duration < 0 or (next_time is not None and next_time < own) else own


def span_end(time: int, duration: int, next_time: int | None, overlap: int) -> int | None:
    """Return the end of an item's span. `duration` -1: none. `next_time`: the time of the next later item."""
    if duration < 0:
        return next_time
    own = time + duration
    return own if next_time is None else min(own, max(next_time, time + overlap))
