"""Counts the items that arrived, with their latencies, and the missing items. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field


def percentile(values: Sequence[int], percent: float) -> int | None:
    """Return the percentile by nearest rank: at least `percent` % of the values do not exceed it.

    Returns None if there are no values.
    """
    if not 0 < percent <= 100:
        raise ValueError(f"a percentile is above 0 and at most 100, not {percent}")
    ranked = sorted(values)
    return ranked[math.ceil(len(ranked) * percent / 100) - 1] if ranked else None


@dataclass(slots=True)
class SequenceAccount:
    """Counts the items that one reader received from one channel, by the channel's seqs.

    `missing` counts skipped seqs; `repeated` counts seqs that are not above the last one.
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
    """A reader's notes about all items: their seqs, sizes and latencies in nanoseconds."""

    account: SequenceAccount = field(default_factory=SequenceAccount)
    payload_bytes: int = 0
    latencies_nanos: list[int] = field(default_factory=list)  # one for each item; the length of the run bounds them

    def add(self, *, seq: int, payload_bytes: int, put_unix_nano: int, received_unix_nano: int) -> None:
        """Note one item. Both instants come from this machine's clock."""
        self.account.add(seq)
        self.payload_bytes += payload_bytes
        self.latencies_nanos.append(received_unix_nano - put_unix_nano)

    def as_record(self) -> dict[str, int | None]:
        """Return the figures that a role reports."""
        return {
            "received": self.account.received,
            "missing": self.account.missing,
            "repeated": self.account.repeated,
            "payload_bytes": self.payload_bytes,
            "latency_p50_nanos": percentile(self.latencies_nanos, 50),
            "latency_p99_nanos": percentile(self.latencies_nanos, 99),
        }
