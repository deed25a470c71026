"""Counting what arrived, when, and what did not. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


def percentile(values: Sequence[int], percent: float) -> int | None:
    """The smallest value that at least `percent` per cent of all values do not exceed (nearest rank); None of none."""
    if not 0 < percent <= 100:
        raise ValueError(f"a percentile lies above 0 and up to 100, not at {percent}")
    ranked = sorted(values)
    return ranked[math.ceil(len(ranked) * percent / 100) - 1] if ranked else None


@dataclass(slots=True)
class SequenceAccount:
    """What one reader received of one channel, judged by the channel's own sequence numbers.

    `missing` counts numbers that were passed over, `repeated` those at or below one already seen.
    """

    received: int = 0
    missing: int = 0
    repeated: int = 0
    highest: int | None = None

    def add(self, seq: int) -> None:
        """Account for one received item."""
        if self.highest is not None and seq <= self.highest:
            self.repeated += 1
            return
        if self.highest is not None:
            self.missing += seq - self.highest - 1
        self.highest = seq
        self.received += 1


@dataclass(slots=True)
class Receipts:
    """What a reader notes of every item: its number, its size, and how long it took. Latencies in nanoseconds."""

    account: SequenceAccount = field(default_factory=SequenceAccount)
    payload_bytes: int = 0
    latencies_nanos: list[int] = field(default_factory=list)  # one per item of a run that is bounded in time

    def add(self, *, seq: int, payload_bytes: int, put_unix_nano: int, received_unix_nano: int) -> None:
        """Note one item. Both instants are of this machine's clock."""
        self.account.add(seq)
        self.payload_bytes += payload_bytes
        self.latencies_nanos.append(received_unix_nano - put_unix_nano)

    def as_record(self) -> dict[str, int | None]:
        """The figures that a role reports."""
        return {
            "received": self.account.received,
            "missing": self.account.missing,
            "repeated": self.account.repeated,
            "payload_bytes": self.payload_bytes,
            "latency_p50_nanos": percentile(self.latencies_nanos, 50),
            "latency_p99_nanos": percentile(self.latencies_nanos, 99),
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class Step:
    """One caption's span as the viewer got it: how many items of each stream, all there or not, and when.

    `received_unix_nano` holds, by stream, when its answer was in the viewer's hands.
    """

    time: int
    end: int
    text: str
    counts: Mapping[str, int]
    complete: bool
    features_keep_times: bool
    received_unix_nano: Mapping[str, int]

    def skew_nanos(self, stream: str, reference: str) -> int:
        """How far apart the answers of `stream` and of `reference` came (the measure of the paper's Figure 7)."""
        return abs(self.received_unix_nano[stream] - self.received_unix_nano[reference])


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamFigures:
    """One line of the final table. Latencies and skews in nanoseconds; None: nothing to measure."""

    name: str
    host: str
    accepted: int
    received: int
    in_step: int
    payload_bytes: int
    seconds: float
    latency_p50_nanos: int | None
    latency_p99_nanos: int | None
    skew_p50_nanos: int | None
    skew_p99_nanos: int | None

    @property
    def lost(self) -> int:
        """Items that the host accepted and the stream's reader never received."""
        return self.accepted - self.received


def stream_figures(
    name: str,
    *,
    host: str,
    accepted: int,
    receipts: Mapping[str, int | None],
    steps: Sequence[Step],
    reference: str,
    seconds: float,
) -> StreamFigures:
    """Put together what the host counted, what the stream's reader noted and what the viewer saw in step."""
    skews = [step.skew_nanos(name, reference) for step in steps]
    return StreamFigures(
        name=name,
        host=host,
        accepted=accepted,
        received=receipts["received"] or 0,
        in_step=sum(step.counts[name] for step in steps),
        payload_bytes=receipts["payload_bytes"] or 0,
        seconds=seconds,
        latency_p50_nanos=receipts["latency_p50_nanos"],
        latency_p99_nanos=receipts["latency_p99_nanos"],
        skew_p50_nanos=percentile(skews, 50),
        skew_p99_nanos=percentile(skews, 99),
    )
