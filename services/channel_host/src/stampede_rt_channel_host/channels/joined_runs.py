"""Joins small items that were put one by one into runs of many items, for readers.

Each run costs a reader and its host several microseconds, so a long answer of single items would take many times the
time of an answer of whole runs. The stored runs stay as they are.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from itertools import pairwise

from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.plain_runs import sealed_payload_at
from stampede_rt.wire.runs import RUN_BYTES_MAX, encode_run, seal_run
from stampede_rt_channel_host.core.channel import ABSENT, DeliveredSlice, ItemKey, Run, Slice, make_run
from stampede_rt_channel_host.core.channel.run import SingleItemRun

ITEM_BYTES_MAX = 4096  # a copy of a longer payload costs about as much as the run that it saves


def joined_slices(slices: Iterable[Slice], ends: Container[ItemKey] = ()) -> Iterator[tuple[Slice, int]]:
    """The slices in their order, each with the number of stored runs in it.

    Joins neighbours without labels whose seqs follow each other and whose times do not descend. `ends`: the last times
    and end seqs at which a slice must end.
    """
    joining = _Joining()
    for part in slices:
        run = part.run
        if not joining.take(run):
            yield from map(_whole, joining.ended())
            if not joining.take(run):
                yield part, 1
                continue
        if ends and (part.last_time, part.end_seq) in ends:
            yield from map(_whole, joining.ended())
    yield from map(_whole, joining.ended())


def joined_deliveries(slices: Sequence[DeliveredSlice]) -> Iterator[DeliveredSlice]:
    """Join the slices of a subscription. Each keeps the time of the next bucket after it.

    A slice ends where the next bucket of the channel is not in the next slice: there the reader would compute another
    end of a span from the joined run.
    """
    next_times = {(one.slice.last_time, one.slice.end_seq): one.next_time for one in slices}
    ends = {(one.slice.last_time, one.slice.end_seq) for one, other in pairwise(slices) if not _continues(one, other)}
    for part, _ in joined_slices((one.slice for one in slices), ends):
        yield DeliveredSlice(part, next_times[part.last_time, part.end_seq])


def _continues(one: DeliveredSlice, other: DeliveredSlice) -> bool:
    """Whether `other` begins with the next bucket after `one`, or in the bucket of `one`, with the same next bucket."""
    time = other.slice.first_time
    return one.next_time == (time if one.slice.last_time < time else other.next_time)


def joined_runs(runs: Iterable[Run]) -> list[Run]:
    """Join whole runs, in the order of their seqs."""
    joining, found = _Joining(), list[Run]()
    for run in runs:
        if not joining.take(run):
            found += joining.ended()
            if not joining.take(run):
                found.append(run)
    return found + joining.ended()


class _Joining:
    """Single items that become one run."""

    def __init__(self) -> None:
        self._runs: list[SingleItemRun] = []
        self._payloads: list[bytes] = []
        self._bytes = self._end_seq = self._last_time = 0

    def take(self, run: Run) -> bool:
        """Add a run. Returns False if it has several items, labels or a long payload, or does not follow the others."""
        if not isinstance(run, SingleItemRun) or run.length > ITEM_BYTES_MAX:
            return False
        if self._runs and not self._is_followed_by(run):
            return False
        body = bytes(run.body)
        begin = sealed_payload_at(body, run.length)
        if not begin:
            return False
        self._runs.append(run)
        self._payloads.append(body[begin : begin + run.length])
        self._bytes += run.length
        self._end_seq, self._last_time = run.first_seq + 1, run.first_time
        return True

    def _is_followed_by(self, run: SingleItemRun) -> bool:
        has_room = len(self._runs) < RUN_ITEMS_MAX and self._bytes + run.length <= RUN_BYTES_MAX
        return has_room and run.first_seq == self._end_seq and run.first_time >= self._last_time

    def ended(self) -> list[Run]:
        """The run of the items so far, if there are any. The next item begins another run."""
        runs, payloads = self._runs, self._payloads
        self._runs, self._payloads, self._bytes = [], [], 0
        return [*runs] if len(runs) < 2 else [_run_of(runs, payloads)]


def _whole(run: Run) -> tuple[Slice, int]:
    return Slice(run, 0, len(run)), len(run)


def _run_of(runs: Sequence[SingleItemRun], payloads: Sequence[bytes]) -> Run:
    times, lengths = [one.first_time for one in runs], [one.length for one in runs]
    all_durations = [one.duration for one in runs]
    durations = all_durations if max(all_durations) > ABSENT else None
    encoded = encode_run(payloads, times=times, durations=durations)
    return make_run(runs[0].first_seq, times, durations, lengths, seal_run(encoded, runs[0].first_seq))
