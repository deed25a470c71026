"""The order in which a caller should try supernodes (paper, section 4: clients take the nearest by latency). Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

_SMOOTHING = 8  # a new measurement counts for one eighth, as in TCP's round-trip estimate (RFC 6298)


@dataclass(frozen=True, kw_only=True, slots=True)
class Supernode:
    """The known facts of one supernode.

    `has_answered`: the supernode answered the last probe. `healthy`: its answer said that it can serve.
    `round_trip_nanos` is smoothed over the probes; None if no round trip was measured.
    """

    supernode_id: str
    target: str
    zone: str = ""
    is_leader: bool = False
    has_answered: bool = False
    healthy: bool = False
    round_trip_nanos: int | None = None


def rank(supernodes: Iterable[Supernode], zone: str) -> list[Supernode]:
    """The supernodes, best first.

    Healthy supernodes come first. Among equals, supernodes in the caller's `zone` come first, unless `zone` is empty.
    Among equals again, a shorter round trip comes first, and then a lower id. A round trip that was never measured
    counts as the longest.
    """

    def order(node: Supernode) -> tuple[bool, bool, bool, int, str]:
        is_in_other_zone = bool(zone) and node.zone != zone
        unmeasured = node.round_trip_nanos is None
        return (not node.healthy, is_in_other_zone, unmeasured, node.round_trip_nanos or 0, node.supernode_id)

    return sorted(supernodes, key=order)


def smooth(previous_nanos: int | None, sample_nanos: int) -> int:
    """The smoothed round trip after one more measurement. The first measurement counts whole."""
    if previous_nanos is None:
        return sample_nanos
    return previous_nanos + (sample_nanos - previous_nanos) // _SMOOTHING
