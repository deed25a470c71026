"""Recognises retried puts by the numbers of each producer's latest runs, and keeps the outcomes of these runs. Pure.

Nearly every run is accepted as a whole. Such a run takes up five numbers in an array. The window has a bound in bytes,
and its bytes count against the host's memory.
"""

from __future__ import annotations

from array import array
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart, up_to_seq

RUNS_MAX = 1024  # much more than the runs that a producer has in flight
KEPT_NANOS = 600_000_000_000  # the time that the window keeps an outcome
PRODUCERS_MAX = 4096
WINDOW_BYTES_MAX = 16 * 2**20
SHED_PARTS = 64  # above a bound, one step frees about 1/64 of the bound, so that such steps are rare
PRODUCER_BYTES_MAX = 256 * 2**10

RUN_BYTES = 48  # five numbers of 8 bytes, and the spare room of a growing array
PRODUCER_BYTES = 400  # the memory of a producer without its runs, as measured
_PART_BYTES = 200  # a `RunPart`
_REFUSAL_BYTES = 900  # an error, with a sentence of its own

# The numbers of a run in the array: first number, items, first seq (0: see `odd`), time that the host gave the items
# (_NO_STAMP: none), time of the record.
_FIELDS = 5
_NO_STAMP = -(2**63)  # the host gave the items no time
_SLACK_RUNS = 256  # at most this many forgotten runs stay in the array; then one step removes them


_NOTHING = RunOutcome(0, 0, (), (), 0)


class KeptRun(NamedTuple):
    """A run in the window, for the host that takes the channel or queue over. `caller_name`: as in `record`."""

    producer_id: int
    first_number: int
    outcome: RunOutcome
    caller_name: str = ""


class KnownProducer:
    """One producer's latest runs, in the order in which they were recorded. `end` is above all their numbers.

    `odd` holds the outcomes that do not fit in the array, by first number. `latest` is the time of the last record.
    `caller_name` is the name of the caller that put last. `recorded` counts the records.
    """

    __slots__ = ("_begin", "_columns", "_odd_bytes", "caller_name", "end", "latest", "odd", "recorded")

    def __init__(self) -> None:
        self._columns = array("q")
        self._begin = 0  # the number of forgotten runs at the beginning of the array
        self._odd_bytes = 0
        self.odd: dict[int, RunOutcome] = {}
        self.end = 0
        self.latest = 0
        self.caller_name = ""
        self.recorded = 0

    def __len__(self) -> int:
        return len(self._columns) // _FIELDS - self._begin

    @property
    def footprint_bytes(self) -> int:
        """Its memory, in bytes."""
        return PRODUCER_BYTES + len(self._columns) // _FIELDS * RUN_BYTES + self._odd_bytes

    def add(self, first_number: int, outcome: RunOutcome) -> None:
        """Add a record. It replaces the latest record if this is of the same run, which waits for room in the
        meantime.
        """
        if len(self) and self._columns[-_FIELDS] == _signed(first_number):
            self.drop_newest()
        if self.odd:
            self._forget_odd(first_number)
        part = outcome.parts[0]
        if len(outcome.parts) > 1 or part.items < outcome.items:
            self.odd[first_number] = outcome
            self._odd_bytes += _odd_bytes(outcome)
            part = RunPart(0, 0, 0, None)
        stamp = _NO_STAMP if part.stamped_time is None else part.stamped_time
        self._columns.extend((_signed(first_number), outcome.items, part.first_seq, stamp, outcome.time))
        self.end = max(self.end, first_number + outcome.items)
        self.latest = outcome.time
        self.recorded += 1

    def runs(self) -> Iterator[tuple[int, RunOutcome]]:
        """First numbers and outcomes, the latest first. A run that was judged in two steps may come twice, both times
        with its latest outcome.
        """
        columns = self._columns
        for at in range(len(columns) - _FIELDS, self._begin * _FIELDS - 1, -_FIELDS):
            first, items, first_seq, stamp, time = columns[at : at + _FIELDS]
            first %= 2**64
            if first_seq:
                part = RunPart(0, first_seq, items, None if stamp == _NO_STAMP else stamp)
                yield first, RunOutcome(items, items, (part,), (), time)
            elif first in self.odd:
                yield first, self.odd[first]

    def copied(self) -> KnownProducer:
        """A copy for `runs`."""
        copy = KnownProducer.__new__(KnownProducer)
        copy._columns, copy._begin, copy.odd, copy.caller_name = (
            self._columns[:],
            self._begin,
            {**self.odd},
            self.caller_name,
        )
        return copy

    def find(self, producer_id: int, first_number: int, end: int, since: int) -> RunOutcome | None:
        """The outcome of the run with exactly these numbers, if it was recorded after `since`; otherwise None.

        Raises InvalidArgument if the numbers overlap another run's numbers.
        """
        for first, outcome in self.runs():
            if outcome.time <= since:
                return None
            if (first, first + outcome.items) == (first_number, end):
                return outcome
            if first < end and first_number < first + outcome.items:
                raise InvalidArgument(
                    f"the numbers {first_number} to {end - 1} of producer {producer_id:x} overlap the run {first} to "
                    f"{first + outcome.items - 1}, which was put before; retry a run as it was, and give new items new "
                    "numbers"
                )
        return None

    def drop_oldest(self) -> None:
        """Forget the run with the earliest record."""
        at = self._begin * _FIELDS
        first, first_seq, time = self._columns[at] % 2**64, self._columns[at + 2], self._columns[at + 4]
        if not first_seq and first in self.odd and self.odd[first].time == time:
            self._forget_odd(first)
        self._begin += 1
        if self._begin > _SLACK_RUNS:
            del self._columns[: self._begin * _FIELDS]
            self._begin = 0

    def oldest_time(self) -> int:
        """The time of the earliest record. There must be one."""
        return self._columns[self._begin * _FIELDS + 4]

    def keep_up_to(self, next_seq: int) -> None:
        """See `RetryWindow.keep_up_to`."""
        cut = 0, _NOTHING
        while len(self):
            first_number, outcome = next(self.runs(), (0, _NOTHING))
            if 0 < outcome.end_seq <= next_seq:
                break
            cut = (first_number, up_to_seq(outcome, next_seq)) if outcome.parts else cut
            self.drop_newest()
        if cut[1].parts:
            self.add(*cut)

    def drop_newest(self) -> None:
        """Forget the latest record."""
        first, first_seq = self._columns[-_FIELDS] % 2**64, self._columns[-_FIELDS + 2]
        if not first_seq:
            self._forget_odd(first)
        del self._columns[-_FIELDS:]

    def _forget_odd(self, first_number: int) -> None:
        """Forget the outcome in `odd` of the run that begins with this number, if there is one."""
        known = self.odd.pop(first_number, None)
        self._odd_bytes -= 0 if known is None else _odd_bytes(known)


class RetryWindow:
    """The outcomes of each producer's latest runs. A retried run gets its former outcome and is not stored twice.

    A run that was judged in part continues at its first unjudged item. The time model asks for the last 1024 numbers of
    each producer for 10 minutes. The window keeps the last 1024 runs of each producer, which have at least these
    numbers.

    The window knows at most `producers_max` producers, and takes up at most `bytes_max` bytes. Each producer takes up
    at most PRODUCER_BYTES_MAX bytes, or has a single run. Above a bound of the window, it forgets producers of the
    caller that takes up most. It first forgets the producers that have been silent longest. So one caller does not push
    out the producers of other callers.

    The window keeps no run without an accepted item; the channel or queue judges such a run anew. A run with producer
    id 0 is never recognised. `now` is the host's clock in nanoseconds and never goes back.
    """

    __slots__ = ("_bytes_max", "_producers_max", "footprint_bytes", "producers", "recorded")

    def __init__(self, *, producers_max: int = PRODUCERS_MAX, bytes_max: int = WINDOW_BYTES_MAX) -> None:
        self._producers_max = producers_max
        self._bytes_max = bytes_max
        self.producers: OrderedDict[int, KnownProducer] = OrderedDict()  # by id, the longest silent one first
        self.footprint_bytes = 0
        self.recorded = 0  # counts the records

    def __len__(self) -> int:
        """The number of known producers."""
        return len(self.producers)

    @property
    def latest_time(self) -> int | None:
        """The time of the latest record; None if the window is empty."""
        latest = next(reversed(self.producers.values()), None)
        return None if latest is None else latest.latest

    def adopt(self, run: KeptRun) -> None:
        """Record a run that the window of the channel's owner has, unless this window has it already."""
        numbers = run.producer_id, run.first_number, run.outcome.items
        try:
            known = self.find(*numbers, run.outcome.time)
        except InvalidArgument:  # the owner has lost the run that this window still has
            self._forget(run.producer_id)
            known = None
        if known is None or known[:-1] != run.outcome[:-1]:
            self.record(run.producer_id, run.first_number, run.outcome, run.caller_name)

    def keep_up_to(self, next_seq: int) -> None:
        """Forget the entries about items with the seq `next_seq` or a later one, because they are lost.

        If a run has earlier items, too, it counts as judged up to them, so that a retry continues there.
        """
        for producer_id, producer in [*self.producers.items()]:
            before = producer.footprint_bytes
            producer.keep_up_to(next_seq)
            self.footprint_bytes += producer.footprint_bytes - before
            if not len(producer):
                self._forget(producer_id)

    def kept(self, now: int) -> Iterator[KeptRun]:
        """Every run not older than KEPT_NANOS, for `record` at another host.

        Each producer's runs come in the order in which they were recorded.
        """
        return kept_runs(self.producers, now)

    def find(self, producer_id: int, first_number: int, items: int, now: int) -> RunOutcome | None:
        """The former outcome of a repeated run, or None if the window does not know the run.

        Raises InvalidArgument if some of the run's numbers belong to another known run.
        """
        producer = self.producers.get(producer_id)
        if producer is None or first_number >= producer.end:
            return None
        return producer.find(producer_id, first_number, first_number + items, now - KEPT_NANOS)

    def record(self, producer_id: int, first_number: int, outcome: RunOutcome, caller_name: str = "") -> None:
        """Keep the outcome of a run, or of its first items, as of `outcome.time`.

        Keeps nothing for producer id 0, or if no item was accepted. `caller_name` is the name of the caller; empty if
        the caller has no name of its own.
        """
        if not producer_id or not outcome.parts:
            return
        producer = self.producers.get(producer_id)
        if producer is None:
            producer = self.producers[producer_id] = KnownProducer()
            self.footprint_bytes += producer.footprint_bytes
        self.producers.move_to_end(producer_id)
        producer.caller_name = caller_name
        self.recorded += 1
        before = producer.footprint_bytes
        producer.add(first_number, outcome)
        while len(producer) > RUNS_MAX or producer.oldest_time() <= outcome.time - KEPT_NANOS:
            producer.drop_oldest()
        while (after := producer.footprint_bytes) > PRODUCER_BYTES_MAX and len(producer) > 1:
            producer.drop_oldest()
        self.footprint_bytes += after - before
        self.expire(outcome.time)

    def expire(self, now: int) -> None:
        """Forget producers that have put nothing for ten minutes. Above the bounds, forget more (see the class)."""
        while self.producers:
            producer_id, producer = next(iter(self.producers.items()))
            if producer.latest > now - KEPT_NANOS:
                break
            self._forget(producer_id)
        if len(self.producers) > self._producers_max:
            spare = self._producers_max // SHED_PARTS  # a look at all producers makes room for many new ones
            while len(self.producers) > self._producers_max - spare and self._shed(lambda producer: 1, spare + 1):
                pass
        while self.footprint_bytes > self._bytes_max and self._shed(
            lambda producer: producer.footprint_bytes, self._bytes_max // SHED_PARTS
        ):
            pass

    def _shed(self, size: Callable[[KnownProducer], int], least: int) -> bool:
        """Forget the longest silent producers of the largest caller, until the sum of their `size` is `least`.

        The largest caller is the caller whose producers have the largest sum of `size`. The producer that put last
        stays. Returns whether a producer was forgotten.
        """
        others = list(self.producers.items())[:-1]
        sizes: Counter[str] = Counter()
        for _, producer in others:
            sizes[producer.caller_name] += size(producer)
        largest = max(sizes, key=sizes.__getitem__, default="")
        freed = 0
        for producer_id, producer in others:
            if producer.caller_name == largest:
                freed += size(producer)
                self._forget(producer_id)
                if freed >= least:
                    break
        return freed > 0

    def _forget(self, producer_id: int) -> None:
        self.footprint_bytes -= self.producers.pop(producer_id).footprint_bytes

    def next_expiry(self) -> int | None:
        """The time at which `expire` next forgets a producer if nothing is put, or None if the window is empty."""
        longest_silent = next(iter(self.producers.values()), None)
        return None if longest_silent is None else longest_silent.latest + KEPT_NANOS


def kept_runs(producers: Mapping[int, KnownProducer], now: int) -> Iterator[KeptRun]:
    """See `RetryWindow.kept`."""
    for producer_id, producer in producers.items():
        latest = dict(reversed(list(producer.runs())))
        for first_number, outcome in latest.items():
            if outcome.time > now - KEPT_NANOS:
                yield KeptRun(producer_id, first_number, outcome, producer.caller_name)


def _odd_bytes(outcome: RunOutcome) -> int:
    """About how many bytes an outcome takes if it does not fit in the array."""
    texts = sum(len(one.error.message) + 100 * len(one.error.metadata) for one in outcome.refusals)
    return _PART_BYTES * (1 + len(outcome.parts)) + _REFUSAL_BYTES * len(outcome.refusals) + texts


def _signed(number: int) -> int:
    """The number as a signed integer of 64 bits, as arrays hold it."""
    return number - 2**64 if number >= 2**63 else number
