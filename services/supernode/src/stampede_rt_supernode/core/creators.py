"""How much each caller has made, and when it may make no more. Pure."""

from __future__ import annotations

from collections import Counter

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.core.commands import Creation


class Creators:
    """How many things of one kind each caller has made that are there. Nobody is counted whose name is not known."""

    def __init__(self) -> None:
        self._made: Counter[str] = Counter()

    def __getitem__(self, name: str) -> int:
        return self._made[name]

    def note(self, name: str, step: int) -> None:
        """A thing of that caller is there (1), or is not any more (-1)."""
        if name:
            self._made[name] += step
            if not self._made[name]:
                del self._made[name]

    def check(self, operation: Creation, kind: str) -> None:
        """Whether the caller may make another one. `kind`: as in "channels". Raises Overloaded."""
        made, limit = self._made[operation.created_by], operation.created_max
        if limit is None or made < limit:
            return
        name = operation.created_by
        raise Overloaded(
            f"{name} has made {made} {kind} that are there; its quota {kind} is {limit}; delete some, or have an "
            f"operator raise it (stampede quota set {name} {kind}=LIMIT)",
            metadata={"quota": kind, "subject": name, "used": str(made), "limit": str(limit)},
        )
