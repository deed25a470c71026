"""Recognising retried puts: the last runs of each producer with what became of them. Pure."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from stampede_rt.errors import InvalidArgument

RUNS_MAX = 1024  # far above the runs that a producer has in flight, whatever their length
KEPT_NANOS = 600_000_000_000
PRODUCERS_MAX = 4096

Outcome = TypeVar("Outcome")


class _Put(NamedTuple, Generic[Outcome]):
    """One run as it was answered; its numbers are `first` up to, not including, `end`."""

    first: int
    end: int
    time: int
    outcome: Outcome


class KeptRun(NamedTuple, Generic[Outcome]):
    """A run as the window knows it, for the host that takes over; `time` is when it was recorded."""

    producer_id: int
    first_number: int
    items: int
    outcome: Outcome
    time: int


class _Producer(Generic[Outcome]):
    """One producer's latest runs in the order in which they were recorded; `end` is above all its numbers."""

    __slots__ = ("end", "puts")

    def __init__(self) -> None:
        self.puts: deque[_Put[Outcome]] = deque(maxlen=RUNS_MAX)
        self.end = 0


class KnownRun(NamedTuple, Generic[Outcome]):
    """A run that is remembered, as a value: how long ago it was answered, and how."""

    first_number: int
    items: int
    answered_ago_nanos: int
    outcome: Outcome


class KnownProducer(NamedTuple, Generic[Outcome]):
    """What is remembered of one producer, as a value: its runs in the order in which they were answered."""

    producer_id: int
    runs: Sequence[KnownRun[Outcome]]


class RetryWindow(Generic[Outcome]):
    """Outcomes of each producer's latest runs, so that a retried run is answered as before and not doubled.

    The time model asks for the last 1024 numbers of each producer for 10 minutes; kept are its last 1024 runs, which
    are these numbers and, where runs hold several items, more. At most `producers_max` producers are known, of which
    the longest silent is forgotten first. Producer id 0 asks for nothing to be recognised. `now` is the host's clock
    in nanoseconds and never runs backwards.
    """

    def __init__(self, *, producers_max: int = PRODUCERS_MAX) -> None:
        self._producers_max = producers_max
        self._producers: OrderedDict[int, _Producer[Outcome]] = OrderedDict()  # in the order of their latest put

    def __len__(self) -> int:
        """How many producers are known."""
        return len(self._producers)

    def kept(self, now: int) -> Iterator[KeptRun[Outcome]]:
        """Every run that is known, each producer's in the order of their coming: `record` them elsewhere, in order."""
        for producer_id, producer in self._producers.items():
            for put in producer.puts:
                if put.time > now - KEPT_NANOS:
                    yield KeptRun(producer_id, put.first, put.end - put.first, put.outcome, put.time)

    def find(self, producer_id: int, first_number: int, items: int, now: int) -> Outcome | None:
        """What became of this run when it came before; None if it is new, or older than what is kept.

        Raises InvalidArgument if only some of its numbers, or more than these, were put before as one run.
        """
        producer = self._producers.get(producer_id)
        if producer is None or first_number >= producer.end:
            return None
        end = first_number + items
        for put in reversed(producer.puts):
            if put.time <= now - KEPT_NANOS:
                continue
            if (put.first, put.end) == (first_number, end):
                return put.outcome
            if put.first < end and first_number < put.end:
                raise InvalidArgument(
                    f"the numbers {first_number} to {end - 1} of producer {producer_id:x} overlap the run {put.first} "
                    f"to {put.end - 1}, which was put before; retry a run as it was, and give new items new numbers"
                )
        return None

    def record(self, producer_id: int, first_number: int, items: int, outcome: Outcome, now: int) -> None:
        """Keep what became of a run. Nothing is kept for producer id 0."""
        if not producer_id:
            return
        producer = self._producers.get(producer_id)
        if producer is None:
            producer = self._producers[producer_id] = _Producer()
        self._producers.move_to_end(producer_id)
        producer.puts.append(_Put(first_number, first_number + items, now, outcome))
        producer.end = max(producer.end, first_number + items)
        while producer.puts and producer.puts[0].time <= now - KEPT_NANOS:
            producer.puts.popleft()
        self._forget_producers(now)

    def known(self, now: int) -> list[KnownProducer[Outcome]]:
        """Everything that is remembered, as values: it moves with the channel. The longest silent producer first."""
        return [
            KnownProducer(producer_id, [_known_run(put, now) for put in producer.puts if put.time > now - KEPT_NANOS])
            for producer_id, producer in self._producers.items()
        ]

    def restore(self, producers: Iterable[KnownProducer[Outcome]], now: int) -> None:
        """Remember what `known` told elsewhere, as if it had been recorded here as long ago. For an empty window."""
        for one in producers:
            for run in one.runs:
                self.record(one.producer_id, run.first_number, run.items, run.outcome, now - run.answered_ago_nanos)

    def _forget_producers(self, now: int) -> None:
        while self._producers:
            producer = next(iter(self._producers.values()))
            if (
                len(self._producers) <= self._producers_max
                and producer.puts
                and producer.puts[-1].time > now - KEPT_NANOS
            ):
                return
            self._producers.popitem(last=False)


def _known_run(put: _Put[Outcome], now: int) -> KnownRun[Outcome]:
    return KnownRun(put.first, put.end - put.first, now - put.time, put.outcome)
