"""The share that one caller may have of the channels, or of the queues, that a host serves."""

from __future__ import annotations

from collections import Counter

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.quotas.limits import SHARED_NAMES


class CreatedHere:
    """How many of a host's channels, or queues, each caller has created. One caller may have at most 3/4 of `bound`.

    A directory may have more channels than one host serves, so the quota `channels` of a caller can be above `bound`.
    Names that several callers share have no such limit.
    """

    def __init__(self, host_name: str, what: str, bound: int) -> None:
        """`what`: the plural, such as "channels"."""
        self._host_name = host_name
        self._what = what
        self._limit = bound * 3 // 4
        self._count_of: Counter[str] = Counter()

    def check(self, created_by: str) -> None:
        """Raises Overloaded if the host serves no further one of this caller."""
        used = self._count_of[created_by]
        if created_by and created_by not in SHARED_NAMES and used >= self._limit:
            raise Overloaded(
                f"host {self._host_name} serves {used} {self._what} that {created_by} has created, the most for one "
                "caller; delete some, or use another host",
                metadata={"subject": created_by, "used": str(used), "limit": str(self._limit)},
            )

    def note(self, created_by: str, step: int) -> None:
        """Add `step`: 1 for one that the host serves from now on, -1 for one that it serves no more."""
        self._count_of[created_by] += step
        if not self._count_of[created_by]:
            del self._count_of[created_by]
