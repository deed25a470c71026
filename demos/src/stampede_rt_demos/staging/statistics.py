"""Counting what arrived, when, and what did not. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
