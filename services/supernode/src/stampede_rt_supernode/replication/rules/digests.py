"""Whether this replica's state is the leader's: digests of what both have applied, compared wherever they meet. Pure.

Replicas do the same commands in the same order, and so come to the same state, as long as they are of one mind about
what a command does. A release that does not know one refuses what the others do, and nothing in the log tells.
"""

from __future__ import annotations

DIGESTS_MAX = 4096


class Digests:
    """The last digests of this replica, and what its leader said last. Tick thread only."""

    def __init__(self) -> None:
        # Where this replica's state was found to differ from its leader's; 0: nowhere. It stays so.
        self.diverged_at = 0
        self._own: dict[int, bytes] = {}  # by position, growing
        self._told: tuple[int, bytes] | None = None  # what lies ahead of this replica

    def note(self, index: int, digest: bytes) -> None:
        """This replica has applied everything up to `index`."""
        self._own[index] = digest
        if len(self._own) > DIGESTS_MAX:
            del self._own[next(iter(self._own))]
        if self._told is not None and index >= self._told[0]:
            told, self._told = self._told, None
            self.told(*told)

    def told(self, index: int, digest: bytes) -> None:
        """The leader has come to `digest` at `index`. A position that this replica does not know is passed over."""
        own = self._own.get(index)
        if own is not None and own != digest and own and digest:
            self.diverged_at = self.diverged_at or index
        elif own is None and self._told is None and index > max(self._own, default=0):
            self._told = (index, digest)
