"""The puts of a channel whose items are not archived yet: when the host accepted them, and their bytes. Pure."""

from __future__ import annotations

from bisect import bisect_right

JOIN_FROM_PUTS, JOIN_FROM_BYTES = 4096, 16 * 2**20
"""If more puts or bytes wait, the puts are joined whose items have left memory."""


class WaitingPuts:
    """The waiting puts, in the order of acceptance. `bytes`: the most bytes that their items take on the disk."""

    def __init__(self, run_bytes_max: int) -> None:
        """`run_bytes_max`: the most bytes of a run on the disk besides its body."""
        self.bytes = 0
        self.instants: list[int] = []
        """The instant of acceptance of each put."""
        self._run_bytes_max = run_bytes_max
        self._ends: list[int] = []  # for each put the seq after its items
        self._sizes: list[int] = []  # and its bytes
        self._puts_max, self._bytes_max = JOIN_FROM_PUTS, JOIN_FROM_BYTES

    @property
    def end_seq(self) -> int | None:
        """The seq after the items of the last put; None: no put waits."""
        return self._ends[-1] if self._ends else None

    def add(self, end_seq: int, now: int, size: int) -> bool:
        """Add a put that the host has accepted at `now`. Returns whether the caller should call `join`."""
        self.bytes += size
        if self._ends and self.instants[-1] == now:
            self._ends[-1] = end_seq
            self._sizes[-1] += size
            return False
        self._ends.append(end_seq)
        self.instants.append(now)
        self._sizes.append(size)
        return len(self._ends) >= self._puts_max or self.bytes >= self._bytes_max

    def join(self, held_from: int) -> None:
        """Join the puts whose items memory has lost while the disk failed: the items before the seq `held_from`. The
        joined put has their first instant.
        """
        done = bisect_right(self._ends, held_from)
        if done:
            self._sizes[:done] = [self._run_bytes_max]
            self.bytes = sum(self._sizes)
        del self._ends[: max(0, done - 1)]
        del self.instants[1:done]
        self._puts_max = max(JOIN_FROM_PUTS, 2 * len(self._ends))
        self._bytes_max = max(JOIN_FROM_BYTES, 2 * self.bytes)

    def end(self, end_seq: int) -> None:
        """Forget the puts whose items are below this seq: the archive has them, or will never have them."""
        done = bisect_right(self._ends, end_seq)
        self.bytes -= sum(self._sizes[:done])
        del self._ends[:done]
        del self.instants[:done]
        del self._sizes[:done]
