"""The loads of copies, as their hosts last reported them to the leader (paper, section 4.1).

Pure: methods take `now`, nanoseconds of a monotonic clock. Loads are not in the log. Each host reports to a new leader
again.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

LOAD_AGE_NANOS_MAX = 10 * 10**9
REPORT_LOADS_MAX = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicaLoad:
    """The load of one host by one channel of which it holds a copy. See ReplicaLoad in replica.proto."""

    channel_id: bytes
    host_id: bytes
    subscriptions: int
    delivered_bytes_per_second: int
    next_seq: int
    lag_nanos: int


class ReplicaLoads:
    """The loads that hosts reported to this leader.

    The caller of `note` must check that the host holds the channels that it reports. So there are at most as many
    entries as copies and owners. Entries older than LOAD_AGE_NANOS_MAX do not count, and a later `note` frees them.
    """

    def __init__(self) -> None:
        self._tenure = 0
        self._loads: dict[bytes, dict[bytes, tuple[int, ReplicaLoad]]] = {}  # channel id -> host id -> time, load
        self._swept_nanos = 0

    def lead(self, tenure: int) -> None:
        """Note that this supernode leads in `tenure`. Forgets the loads that were reported before this tenure."""
        if tenure != self._tenure:
            self._tenure = tenure
            self._loads.clear()

    def note(self, loads: Iterable[ReplicaLoad], now: int) -> None:
        """Note loads reported just now."""
        self._sweep(now)
        for load in loads:
            self._loads.setdefault(load.channel_id, {})[load.host_id] = (now, load)

    def of(self, channel_id: bytes, host_ids: Iterable[bytes], now: int) -> list[ReplicaLoad]:
        """The loads that these hosts reported for a channel within LOAD_AGE_NANOS_MAX, the least loaded first."""
        reported = self._loads.get(channel_id, {})
        fresh = [reported[one] for one in host_ids if one in reported and now - reported[one][0] <= LOAD_AGE_NANOS_MAX]
        return sorted((load for _, load in fresh), key=_weight)

    def _sweep(self, now: int) -> None:
        """Forget loads that are too old, at most once in LOAD_AGE_NANOS_MAX. Amortised O(1) for each report."""
        if now - self._swept_nanos <= LOAD_AGE_NANOS_MAX:
            return
        self._swept_nanos = now
        for channel_id, reported in list(self._loads.items()):
            left = {one: entry for one, entry in reported.items() if now - entry[0] <= LOAD_AGE_NANOS_MAX}
            if left:
                self._loads[channel_id] = left
            else:
                del self._loads[channel_id]


def _weight(load: ReplicaLoad) -> tuple[int, int, bytes]:
    return load.delivered_bytes_per_second, load.subscriptions, load.host_id
