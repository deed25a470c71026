"""What was in step, and each stream's figures. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class StepFigures:
    """One caption's span as the viewer got it: how many items of each stream, all there or not, and when.

    `complete`: every stream had come to the span's end when it was handed over, and nothing of it had been collected.
    `received_unix_nano`: when all of it was in the viewer's hands.
    """

    time: int
    end: int
    text: str
    counts: Mapping[str, int]
    complete: bool
    features_keep_times: bool
    received_unix_nano: int


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamFigures:
    """One line of the final table. Latencies in nanoseconds; None: nothing to measure."""

    name: str
    host: str
    accepted: int
    received: int
    in_step: int
    payload_bytes: int
    seconds: float
    latency_p50_nanos: int | None
    latency_p99_nanos: int | None

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
    steps: Sequence[StepFigures],
    seconds: float,
) -> StreamFigures:
    """Put together what the host counted, what the stream's reader noted and what the viewer saw in step."""
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
    )
