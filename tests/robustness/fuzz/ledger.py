"""Compares the payloads that a client put, by their reported outcomes, with the payloads that are there at the end."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class Ledger:
    """The payloads of one channel or queue, which all differ, by the outcome that the client reported."""

    accepted: set[bytes] = field(default_factory=set)  # acknowledged to the client
    open: set[bytes] = field(default_factory=set)  # the put was interrupted or failed: the payload may be there or not

    def judge(self, held: Counter[bytes]) -> None:
        """Raises AssertionError if a payload is doubled, lost, or was never put.

        `held`: the number of times that each payload is present.
        """
        doubled = [payload for payload, count in held.items() if count > 1]
        assert not doubled, f"doubled: {doubled[:5]}"
        lost = self.accepted - held.keys()
        assert not lost, f"acknowledged and lost: {sorted(lost)[:5]} of {len(self.accepted)}"
        foreign = held.keys() - self.accepted - self.open
        assert not foreign, f"present, but the client never sent them: {sorted(foreign)[:5]}"
