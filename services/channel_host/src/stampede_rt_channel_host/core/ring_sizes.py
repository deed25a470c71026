"""How large a ring in shared memory must be for the runs of its channel. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

DATA_BYTES_MIN, DATA_BYTES_MAX = 4 * 2**20, 64 * 2**20
SHORT_DATA_BYTES_MIN = 2**18
"""The least data of a ring that is shorter than its channel needs, because memory is short."""
RUNS_MIN = 40
"""A ring has room for this many of the longest runs, if DATA_BYTES_MAX allows it.

A producer may have 8 MiB under way. Runs of medium items have up to 224 KiB, so a reader that is one such burst behind
still finds its next items in the ring.
"""
RUNS_OF_SHORT_RING = 4  # a reader needs time to copy a run


class RingFit(NamedTuple):
    """The number of data bytes of a ring, and the longest run that it takes.

    A longer run needs a larger ring, or goes without a ring.
    """

    data_bytes: int
    longest_run: int

    def is_near(self, best: RingFit) -> bool:
        """Whether neither size is twice the other. Then a ring of this size may stay, although `best` is better."""
        return best.data_bytes < 2 * self.data_bytes and self.data_bytes < 2 * best.data_bytes


def ring_fits_for(run_bytes: int) -> Iterator[RingFit]:
    """The possible sizes of a ring for runs of up to this length, the best one first.

    Yields nothing if the runs are too long for a ring. The best size is a multiple of DATA_BYTES_MIN, so that a ring
    seldom needs a larger successor when the items grow. Each further size is half of the size before it, for a host
    whose memory is short.
    """
    wanted = -(-RUNS_MIN * run_bytes // DATA_BYTES_MIN) * DATA_BYTES_MIN
    data_bytes = min(max(wanted, DATA_BYTES_MIN), DATA_BYTES_MAX)
    if data_bytes < DATA_BYTES_MAX:
        yield RingFit(data_bytes, data_bytes // RUNS_MIN)
        data_bytes //= 2
    while data_bytes >= max(SHORT_DATA_BYTES_MIN, RUNS_OF_SHORT_RING * run_bytes):
        yield RingFit(data_bytes, data_bytes // RUNS_OF_SHORT_RING)
        data_bytes //= 2


class RecentRuns:
    """The longest run of the last one to two periods, in bytes. The caller says when a period ends."""

    def __init__(self, longest: int) -> None:
        self._present, self._former = longest, 0

    def note(self, run_bytes: int) -> None:
        """Note a run."""
        self._present = max(self._present, run_bytes)

    def begin_period(self) -> int:
        """Begin a new period. Returns the longest run of the last two periods."""
        longest = max(self._present, self._former)
        self._present, self._former = 0, self._present
        return longest
