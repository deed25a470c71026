"""The kinds and rates of the faults in a simulated run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FaultRates:
    """The faults of a run. Rates are per simulated second and cluster; times are in seconds."""

    loss: float = 0.0
    delay_mean: float = 0.002
    # The share of messages that may overtake other messages, and their greatest additional delay. Except commands, half
    # of these messages come twice.
    reordered: float = 0.0
    reordered_seconds: float = 0.5
    crashes: float = 0.0
    # The mean time of a commit; the share of commits during which the power fails, or the disk hangs for long.
    disk_seconds: float = 0.0
    disk_crash: float = 0.0
    disk_hangs: float = 0.0
    partitions: float = 0.0
    isolations: float = 0.0
    # Leaders that keep one follower only, are replaced, and lead again.
    outvotes: float = 0.0
    freezes: float = 0.0
    link_breaks: float = 0.0
    # The share of the times at which a connection has no room for more entries.
    full_links: float = 0.0
    # Members that come or go.
    changes: float = 0.0
    # Snapshots that operators request, in addition to the snapshots that the log takes by itself.
    snapshots: float = 0.0

    @property
    def late_seconds_max(self) -> float:
        """The greatest delay of a message or of its repetition."""
        return 2 * self.reordered_seconds if self.reordered else 0.0
