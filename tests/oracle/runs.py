"""The oracle's runs: several puts at one instant, and runs that a producer repeats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from stampede_rt_channel_host.core.channel import Offer
from tests.oracle.channel import Item, MustWait, OracleChannel, RefusedItem

KEPT_NANOS = 600_000_000_000
"""A host recognises a repeated run for ten minutes."""


@dataclass(frozen=True)
class OfferOutcome:
    """The outcome of an offer: verdicts up to the first item that has to wait, and the time of items without a time
    of their own.
    """

    verdicts: Sequence[Item | RefusedItem]
    stamp: int
    waits: MustWait | None = None


def put_run(channel: OracleChannel, offer: Offer, clock: int) -> OfferOutcome:
    """Put the items of an offer one after the other."""
    channel.age(clock)  # an item that is too old by now, even the newest one, does not set the time of new items
    stamp = max(
        [channel.now(clock), *channel.collected_times, *([] if channel.advanced_to is None else [channel.advanced_to])]
    )
    waited_since = clock if offer.since is None else offer.since
    verdicts: list[Item | RefusedItem] = []
    for index, length in enumerate(offer.lengths):
        time, since = (offer.times[index], None) if offer.times is not None else (stamp, waited_since)
        duration = None if offer.durations is None or offer.durations[index] < 0 else offer.durations[index]
        verdict = channel.put(time, duration, length, clock, since)
        if isinstance(verdict, MustWait):
            return OfferOutcome(verdicts, stamp, verdict)
        verdicts.append(verdict)
    return OfferOutcome(verdicts, stamp)


@dataclass(frozen=True)
class Ack:
    """The answer to a producer: by position the seq and the time of each accepted item, and the reason of each refused
    one.

    `judged_at` is the host's clock after the last item.
    """

    accepted: Mapping[int, tuple[int, int | None]]
    refused: Mapping[int, str]
    judged_at: int

    @property
    def first(self) -> tuple[int, int | None]:
        """The seq and the time of the first accepted item."""
        return self.accepted[min(self.accepted)]


@dataclass(frozen=True)
class RunOutcome:
    """The known part of a run's outcome: the verdicts up to the first item without one."""

    producer_id: int
    numbers: range
    verdicts: Sequence[Item | RefusedItem]
    judged_at: int

    @property
    def is_whole(self) -> bool:
        return len(self.verdicts) == len(self.numbers)


@dataclass
class OracleRetries:
    """Recognises repeated runs.

    A repeated run with the same numbers gets its former answer, and none of its items is put again. If only its first
    items have verdicts, the others are put now. A run that shares only some numbers with a former run is refused as a
    whole. A run of which no item was accepted is judged anew. A producer without an id is never recognised.
    """

    judged: list[RunOutcome] = field(default_factory=list)

    def find(self, producer_id: int, first_number: int, items: int, clock: int) -> RunOutcome | RefusedItem | None:
        """The outcome of a known run; None: the run is new, or the host has forgotten it."""
        numbers = range(first_number, first_number + items)
        for one in reversed(self.judged):
            known = one.producer_id == producer_id != 0 and one.judged_at > clock - KEPT_NANOS
            if known and one.numbers == numbers:
                return one
            if known and set(one.numbers) & set(numbers):
                return RefusedItem("INVALID_ARGUMENT")
        return None

    def record(
        self, producer_id: int, first_number: int, items: int, verdicts: Sequence[Item | RefusedItem], clock: int
    ) -> None:
        """Keep the outcome so far of a run. Call this after each change of the outcome."""
        if any(isinstance(one, Item) for one in verdicts):
            numbers = range(first_number, first_number + items)
            self.judged.append(RunOutcome(producer_id, numbers, tuple(verdicts), clock))
