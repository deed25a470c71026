"""What kind of bad weather a simulated run has."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Weather:
    """How bad a run is. Rates are per simulated second and cluster; times in seconds."""

    loss: float = 0.0
    delay_mean: float = 0.002
    # Share of messages that overtake others or, commands aside, come twice; how late they may be.
    unruly: float = 0.0
    unruly_seconds: float = 0.5
    crashes: float = 0.0
    # How long a commit takes, on average; the share of commits in which the power is lost, or the disk hangs for long.
    disk_seconds: float = 0.0
    disk_crash: float = 0.0
    disk_hangs: float = 0.0
    partitions: float = 0.0
    isolations: float = 0.0
    # Leaders that are left with one follower, are replaced, and lead again.
    outvotes: float = 0.0
    freezes: float = 0.0
    link_breaks: float = 0.0
    # Share of the times at which a link has no room for more entries.
    full_links: float = 0.0
    # Members that are to come or go.
    changes: float = 0.0
    # Snapshots that somebody wants, beside those that the log takes by itself.
    snapshots: float = 0.0

    @property
    def late_seconds_max(self) -> float:
        """By how much a message may come late, or come again."""
        return 2 * self.unruly_seconds if self.unruly else 0.0
