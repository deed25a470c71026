"""Recognising retried puts: the last numbers of each producer with what became of them. Pure."""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Generic, NamedTuple, TypeVar

from stampede_rt.errors import InvalidArgument

NUMBERS_MAX = 1024
KEPT_NANOS = 600_000_000_000
PRODUCERS_MAX = 4096

Outcome = TypeVar("Outcome")


class _Put(NamedTuple, Generic[Outcome]):
    """One run as it was answered; its numbers are `first` to `first + items - 1`."""

    first: int
    items: int
    time: int
    outcome: Outcome


class RetryWindow(Generic[Outcome]):
    """Outcomes of each producer's latest runs, so that a retried run is answered as before and not doubled.

    Keeps the runs that hold a producer's last 1024 numbers, for 10 minutes, and at most `producers_max` producers, of
    which the longest silent is forgotten first. Producer id 0 asks for nothing to be recognised. `now` is the host's
    clock in nanoseconds and never runs backwards.
    """

    def __init__(self, *, producers_max: int = PRODUCERS_MAX) -> None:
        self._producers_max = producers_max
        # Producers in the order of their latest put; each one's runs in the order in which they were recorded.
        self._producers: OrderedDict[int, deque[_Put[Outcome]]] = OrderedDict()

    def find(self, producer_id: int, first_number: int, items: int, now: int) -> Outcome | None:
        """What became of this run when it came before; None if it is new, or older than what is kept.

        Raises InvalidArgument if the numbers belong to another run: a retry repeats the run as it was.
        """
        for put in reversed(self._producers.get(producer_id, ())):
            if put.time <= now - KEPT_NANOS:
                break
            if put.first == first_number and put.items == items:
                return put.outcome
            if put.first < first_number + items and first_number < put.first + put.items:
                raise InvalidArgument(
                    f"the numbers {first_number} to {first_number + items - 1} of producer {producer_id:x} overlap the "
                    f"run {put.first} to {put.first + put.items - 1}, which was put before; retry a run as it was, and "
                    "give new items new numbers"
                )
        return None

    def record(self, producer_id: int, first_number: int, items: int, outcome: Outcome, now: int) -> None:
        """Keep what became of a run. Nothing is kept for producer id 0."""
        if not producer_id:
            return
        puts = self._producers.setdefault(producer_id, deque())
        self._producers.move_to_end(producer_id)
        puts.append(_Put(first_number, items, now, outcome))
        floor = max(put.first + put.items for put in (puts[0], puts[-1])) - NUMBERS_MAX
        while puts[0].first + puts[0].items <= floor or puts[0].time <= now - KEPT_NANOS or len(puts) > NUMBERS_MAX:
            puts.popleft()
        self._forget_producers(now)

    def _forget_producers(self, now: int) -> None:
        while self._producers:
            puts = next(iter(self._producers.values()))
            if len(self._producers) <= self._producers_max and puts[-1].time > now - KEPT_NANOS:
                return
            self._producers.popitem(last=False)

    def __len__(self) -> int:
        """How many producers are known."""
        return len(self._producers)
