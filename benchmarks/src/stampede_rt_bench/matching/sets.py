"""The sets that a synchroniser returned for a recording, and their judgement. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stampede_rt_bench.matching.recording import RATES_HZ, REFERENCE, Arrival, nearest_sets


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundSet:
    """One set: the time of its return, the reference's time, and the time of the item of each other stream."""

    given: int
    reference: int
    times: Mapping[str, int]


@dataclass(frozen=True, kw_only=True, slots=True)
class Replay:
    """All sets of one run.

    `reported_unmatched`: the number of reported items without a partner; None if the synchroniser cannot report them.
    """

    sets: Sequence[FoundSet]
    reported_unmatched: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """`possible`: the sets of the whole recording. `right`: returned sets that are among these.

    `wrong`: other returned sets. `unmatched`: reference items without a returned set. `reported_count`: the number of
    these items that the synchroniser reported; None if it cannot report them. `delays_nanos`: for each set, the time
    from the arrival of its last item until the synchroniser returned the set.
    """

    possible: int
    right: int
    wrong: int
    unmatched: int
    reported_count: int | None
    delays_nanos: Sequence[int]


def judge(replay: Replay, arrivals: Sequence[Arrival], tolerance_nanos: int) -> Judgement:
    """Compare the returned sets with the sets of the whole recording."""
    possible = nearest_sets(arrivals, tolerance_nanos)
    arrived = {(arrival.stream, arrival.time): arrival.arrived for arrival in arrivals}
    right = sum(possible.get(one.reference) == dict(one.times) for one in replay.sets)
    references = sum(arrival.stream == REFERENCE for arrival in arrivals)
    return Judgement(
        possible=len(possible),
        right=right,
        wrong=len(replay.sets) - right,
        unmatched=references - len({one.reference for one in replay.sets}),
        reported_count=replay.reported_unmatched,
        delays_nanos=sorted(one.given - _complete(one, arrived) for one in replay.sets),
    )


def _complete(found: FoundSet, arrived: Mapping[tuple[str, int], int]) -> int:
    """Return when the last item of the set had arrived."""
    items = {REFERENCE: found.reference, **found.times}
    return max(arrived[stream, items[stream]] for stream in RATES_HZ)
