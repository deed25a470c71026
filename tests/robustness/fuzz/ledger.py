"""What was put, what the client said became of it, and what is there in the end."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class Ledger:
    """Of one channel or queue; payloads are all different."""

    accepted: set[bytes] = field(default_factory=set)  # the client said so
    open: set[bytes] = field(default_factory=set)  # interrupted or failed: it may be there or not
    refused: set[bytes] = field(default_factory=set)  # the client says that it was never handed over

    def judge(self, held: Counter[bytes]) -> None:
        """`held`: each payload that is there, and how often."""
        doubled = [payload for payload, count in held.items() if count > 1]
        assert not doubled, f"doubled: {doubled[:5]}"
        lost = self.accepted - held.keys()
        assert not lost, f"acknowledged and lost: {sorted(lost)[:5]} of {len(self.accepted)}"
        foreign = held.keys() - self.accepted - self.open
        assert not foreign, f"there, but never put or not handed over: {sorted(foreign)[:5]}"
