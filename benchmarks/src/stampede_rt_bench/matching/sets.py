"""What a synchroniser gave for a recording, and how good that was. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stampede_rt_bench.matching.recording import RATES_HZ, REFERENCE, Arrival, nearest_sets


@dataclass(frozen=True, kw_only=True, slots=True)
class FoundSet:
    """One set: when it was given out, the reference's time, and the time of each other stream's item."""

    given: int
    reference: int
    times: Mapping[str, int]


@dataclass(frozen=True, kw_only=True, slots=True)
class Replay:
    """All sets of one run. `told_unmatched`: items without a partner that the user is told of; None: no such word."""

    sets: Sequence[FoundSet]
    told_unmatched: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Judgement:
    """`possible`: sets that a complete view of the recording has; `right`: of the given, those; `wrong`: other ones.

    `unmatched`: items of the reference that no set was given for; `told`: those that the user hears of, None: no such
    word. `delays_nanos`: how long after the arrival of its last item each set was given.
    """

    possible: int
    right: int
    wrong: int
    unmatched: int
    told: int | None
    delays_nanos: Sequence[int]


def judge(replay: Replay, arrivals: Sequence[Arrival], tolerance_nanos: int) -> Judgement:
    """Compare what was given with what a complete view has."""
    possible = nearest_sets(arrivals, tolerance_nanos)
    arrived = {(arrival.stream, arrival.time): arrival.arrived for arrival in arrivals}
    right = sum(possible.get(one.reference) == dict(one.times) for one in replay.sets)
    references = sum(arrival.stream == REFERENCE for arrival in arrivals)
    return Judgement(
        possible=len(possible),
        right=right,
        wrong=len(replay.sets) - right,
        unmatched=references - len({one.reference for one in replay.sets}),
        told=replay.told_unmatched,
        delays_nanos=sorted(one.given - _complete(one, arrived) for one in replay.sets),
    )


def _complete(found: FoundSet, arrived: Mapping[tuple[str, int], int]) -> int:
    """When its last item had arrived."""
    items = {REFERENCE: found.reference, **found.times}
    return max(arrived[stream, items[stream]] for stream in RATES_HZ)
