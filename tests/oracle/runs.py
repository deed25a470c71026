"""Runs by the book: so many puts at one instant, and runs that a producer sends again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from stampede_rt_channel_host.core.channel import Offer
from tests.oracle.channel import Item, OracleChannel, Refused, Waits

KEPT_NANOS = 600_000_000_000
"""For ten minutes a producer's run is recognised."""


@dataclass(frozen=True)
class Taken:
    """What became of an offer: verdicts up to the first item that has to wait, and the time of items without one."""

    verdicts: Sequence[Item | Refused]
    stamp: int
    waits: Waits | None = None


def put_run(channel: OracleChannel, offer: Offer, clock: int) -> Taken:
    """Item after item, each with those before it in."""
    channel.age(clock)  # what is gone by now stamps nothing, not even the newest item
    stamp = max(
        [channel.now(clock), *channel.collected_times, *([] if channel.advanced_to is None else [channel.advanced_to])]
    )
    waited_since = clock if offer.since is None else offer.since
    verdicts: list[Item | Refused] = []
    for index, length in enumerate(offer.lengths):
        time, since = (offer.times[index], None) if offer.times is not None else (stamp, waited_since)
        duration = None if offer.durations is None or offer.durations[index] < 0 else offer.durations[index]
        verdict = channel.put(time, duration, length, clock, since)
        if isinstance(verdict, Waits):
            return Taken(verdicts, stamp, verdict)
        verdicts.append(verdict)
    return Taken(verdicts, stamp)


@dataclass(frozen=True)
class Ack:
    """What a producer is told of a run: by place, the seq and the stamp of each accepted item and the reason of each
    refused one; `judged_at` is the host's clock at the end."""

    accepted: Mapping[int, tuple[int, int | None]]
    refused: Mapping[int, str]
    judged_at: int

    @property
    def first(self) -> tuple[int, int | None]:
        """Seq and stamp of the first accepted item."""
        return self.accepted[min(self.accepted)]


@dataclass(frozen=True)
class RunOutcome:
    """What was known of a run when it was last dealt with: the verdicts up to the first item that had none."""

    producer_id: int
    numbers: range
    verdicts: Sequence[Item | Refused]
    judged_at: int

    @property
    def is_whole(self) -> bool:
        return len(self.verdicts) == len(self.numbers)


@dataclass
class OracleRetries:
    """A run that is sent again under its numbers is answered as before, and nothing of it is put a second time: one of
    which only the front was judged goes on behind it. One that shares only some numbers with a former run is refused
    whole. One of which nothing came in is judged anew. A producer without an id is never recognised."""

    judged: list[RunOutcome] = field(default_factory=list)

    def find(self, producer_id: int, first_number: int, items: int, clock: int) -> RunOutcome | Refused | None:
        """What became of a run that is known; None: it is new, or was forgotten."""
        numbers = range(first_number, first_number + items)
        for one in reversed(self.judged):
            known = one.producer_id == producer_id != 0 and one.judged_at > clock - KEPT_NANOS
            if known and one.numbers == numbers:
                return one
            if known and set(one.numbers) & set(numbers):
                return Refused("INVALID_ARGUMENT")
        return None

    def record(
        self, producer_id: int, first_number: int, items: int, verdicts: Sequence[Item | Refused], clock: int
    ) -> None:
        """The run was dealt with, or nobody waits for it any more."""
        if any(isinstance(one, Item) for one in verdicts):
            numbers = range(first_number, first_number + items)
            self.judged.append(RunOutcome(producer_id, numbers, tuple(verdicts), clock))
