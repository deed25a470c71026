"""Whether this replica's state is the leader's: digests of what both have applied, compared wherever they meet. Pure.

Replicas do the same commands in the same order, and so come to the same state, as long as they are of one mind about
what a command does. A release that does not know one refuses what the others do, and nothing in the log tells.

A state from a snapshot of an earlier release has no digest. It goes on from the leader's as soon as both are at one
position, and is compared from there on.
"""

from __future__ import annotations

from collections.abc import Callable

DIGESTS_MAX = 4096


class Digests:
    """The last digests of this replica, and what its leader said last. Tick thread only."""

    def __init__(self, adopt: Callable[[bytes], None]) -> None:
        """`adopt` gives a state without a digest the one from which it goes on."""
        self._adopt = adopt
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
        last = next(reversed(self._own), 0)
        if own is None:
            if self._told is None and index > last:
                self._told = (index, digest)
        elif not digest:
            pass  # the leader's is not known
        elif not own:
            self._go_on_from(index, digest, last)
        elif own != digest:
            self.diverged_at = self.diverged_at or index

    def _go_on_from(self, index: int, digest: bytes, last: int) -> None:
        if index == last:
            self._own[index] = digest
            self._adopt(digest)
