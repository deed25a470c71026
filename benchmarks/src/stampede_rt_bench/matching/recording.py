"""Makes recordings: the items of three sensors with different rates, and their arrivals. Pure.

The same seed gives the same recording. All instants are int nanoseconds.
"""

from __future__ import annotations

import random
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

NANOS_PER_MS = 1_000_000
NANOS_PER_SECOND = 1_000 * NANOS_PER_MS
FIRST_NANOS = 1_700_000_000 * NANOS_PER_SECOND
RATES_HZ = {"lidar": 10, "camera": 30, "radar": 20}
REFERENCE = "lidar"


class Arrival(NamedTuple):
    """One item of a stream: its time, and the time of its arrival."""

    arrived: int
    stream: str
    time: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Conditions:
    """The faults of the sensors and their links. `drop_share`: the share of lost items.

    `lag_nanos`: by stream, how much later than the others it arrives. `silence`: a stream without items from one second
    to another, counted from the start. `reorders`: items of one stream may overtake each other. `tolerance_nanos`: the
    tolerance for all synchronisers.
    """

    name: str
    jitter_nanos: int = 4 * NANOS_PER_MS
    transport_nanos: tuple[int, int] = (2 * NANOS_PER_MS, 20 * NANOS_PER_MS)
    drop_share: float = 0.0
    lag_nanos: Mapping[str, int] | None = None
    silence: tuple[str, float, float] | None = None
    reorders: bool = False
    tolerance_nanos: int = 20 * NANOS_PER_MS


SCENARIOS = (
    Conditions(name="jitter"),
    Conditions(name="jitter, 5 % lost", drop_share=0.05),
    Conditions(name="radar 300 ms late", lag_nanos={"radar": 300 * NANOS_PER_MS}),
    Conditions(name="camera silent 2 s", silence=("camera", 10.0, 12.0)),
    Conditions(name="tolerance 60 ms, 5 % lost", tolerance_nanos=60 * NANOS_PER_MS, drop_share=0.05),
    Conditions(
        name="reordered, tolerance 60 ms",
        tolerance_nanos=60 * NANOS_PER_MS,
        transport_nanos=(2 * NANOS_PER_MS, 45 * NANOS_PER_MS),
        reorders=True,
    ),
)


def record(conditions: Conditions, seconds: int, seed: int) -> list[Arrival]:
    """Return the arrivals in their order. Each stream arrives in the order of its times, unless it `reorders`."""
    random_source = random.Random(f"{seed} {conditions.name}")
    arrivals: list[Arrival] = []
    for stream, rate_hz in RATES_HZ.items():
        before = 0
        for number in range(seconds * rate_hz):
            due = FIRST_NANOS + number * NANOS_PER_SECOND // rate_hz
            time = due + random_source.randint(-conditions.jitter_nanos, conditions.jitter_nanos)
            if random_source.random() < conditions.drop_share or _is_silent(conditions, stream, due):
                continue
            lag = (conditions.lag_nanos or {}).get(stream, 0)
            arrived = time + lag + random_source.randint(*conditions.transport_nanos)
            before = arrived if conditions.reorders else max(before + 1, arrived)
            arrivals.append(Arrival(before, stream, time))
    return sorted(arrivals)


def _is_silent(conditions: Conditions, stream: str, due: int) -> bool:
    if conditions.silence is None or conditions.silence[0] != stream:
        return False
    _, first_s, last_s = conditions.silence
    return first_s <= (due - FIRST_NANOS) / NANOS_PER_SECOND < last_s


def times_of(arrivals: Sequence[Arrival], stream: str) -> list[int]:
    """Return the times of a stream's items, ascending."""
    return sorted(arrival.time for arrival in arrivals if arrival.stream == stream)


def nearest_sets(arrivals: Sequence[Arrival], tolerance_nanos: int) -> dict[int, dict[str, int]]:
    """Map the time of each reference item that has a partner in every stream to the nearest time of each stream."""
    others = {stream: times_of(arrivals, stream) for stream in RATES_HZ if stream != REFERENCE}
    sets = {}
    for time in times_of(arrivals, REFERENCE):
        found = {stream: _nearest(times, time) for stream, times in others.items()}
        near = {stream: one for stream, one in found.items() if one is not None and abs(one - time) <= tolerance_nanos}
        if len(near) == len(others):
            sets[time] = near
    return sets


def _nearest(times: Sequence[int], time: int) -> int | None:
    at = bisect_left(times, time)
    return min(times[max(at - 1, 0) : at + 1], key=lambda one: (abs(one - time), one), default=None)
