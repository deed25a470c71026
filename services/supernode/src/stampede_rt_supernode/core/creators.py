"""Counts the things that each caller has created, and checks the caller's limit. Pure."""

from __future__ import annotations

from collections import Counter

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.core.commands import Creation


class Creators:
    """Counts, for each caller, the existing things of one kind that this caller has created.

    Things of callers without a known name are not counted.
    """

    def __init__(self) -> None:
        self._made: Counter[str] = Counter()

    def __getitem__(self, name: str) -> int:
        return self._made[name]

    def largest(self, callers_max: int) -> list[tuple[str, int]]:
        """Up to `callers_max` callers with the most things, and the number of things of each."""
        return self._made.most_common(callers_max)

    def note(self, name: str, step: int) -> None:
        """Add `step` to the caller's number: 1 for a thing that the caller has created, -1 when the thing is gone."""
        if name:
            self._made[name] += step
            if not self._made[name]:
                del self._made[name]

    def check(self, operation: Creation, kind: str, *, created: str = "created", way_out: str = "delete some") -> None:
        """Check that the caller may create another thing. Raises Overloaded.

        The error text contains `kind` (such as "channels"), `created` and `way_out`.
        """
        made, limit = self._made[operation.created_by], operation.created_max
        if limit is None or made < limit:
            return
        name = operation.created_by
        raise Overloaded(
            f"{name} has {created} {made} {kind} that still exist; its quota of {kind} is {limit}; {way_out}, or have "
            f"an operator raise the quota (stampede quota set {name} {kind}=LIMIT)",
            metadata={"quota": kind, "subject": name, "used": str(made), "limit": str(limit)},
        )
