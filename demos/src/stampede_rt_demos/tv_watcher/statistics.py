"""The figures of spans and of streams. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class StepFigures:
    """One caption's span at the viewer: the number of items of each stream, whether it was complete, and when it came.

    `complete`: every stream had reached the end of the span when the event came, and retention had collected none of
    its items. `received_unix_nano`: when the viewer had all items of the span.
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
    """One line of the final table. Latencies are in nanoseconds; None: no items to measure."""

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
    """Combine the host's counter, the notes of the stream's reader, and the viewer's steps."""
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
