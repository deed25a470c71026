"""Limits the part of a host's channels, or of its queues, that one caller may have created."""

from __future__ import annotations

from collections import Counter

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.quotas.limits import SHARED_NAMES


class CreationShares:
    """The number of a host's channels, or queues, that each caller has created: at most 3/4 of `bound` for one caller.

    The quota `channels` of a caller can be above `bound`, because a directory may have more channels than one host
    serves. Callers that share one name (SHARED_NAMES) have no such limit.
    """

    def __init__(self, host_name: str, what: str, bound: int) -> None:
        """`what`: the counted things as a plural, "channels" or "queues". `bound`: the most of them at the host."""
        self._host_name = host_name
        self._what = what
        self._limit = bound * 3 // 4
        self._count_of: Counter[str] = Counter()

    def check(self, created_by: str) -> None:
        """Raises Overloaded if the host serves the most channels or queues of this caller already."""
        used = self._count_of[created_by]
        if created_by and created_by not in SHARED_NAMES and used >= self._limit:
            raise Overloaded(
                f"host {self._host_name} serves {used} {self._what} that {created_by} has created, the most for one "
                "caller; delete some, or use another host",
                metadata={"subject": created_by, "used": str(used), "limit": str(self._limit)},
            )

    def note(self, created_by: str, step: int) -> None:
        """Count one more channel or queue of the caller (`step` 1), or one less (`step` -1)."""
        self._count_of[created_by] += step
        if not self._count_of[created_by]:
            del self._count_of[created_by]
