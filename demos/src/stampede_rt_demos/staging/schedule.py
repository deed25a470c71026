"""Computes when each item of a looped clip is due. Pure; in whole nanoseconds, so that times do not drift.

The time of the nth item depends only on n, and not on the previous item. So a late put does not delay later items.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NANOS_PER_SECOND = 1_000_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedItem:
    """One item to put. `time` is the instant of its content; `due` is the instant at which a real source has it.

    A frame and a caption are due when they begin. A block of sound is due when its last sample is over. All values are
    nanoseconds, `time` and `due` since the epoch.
    """

    time: int
    duration: int
    due: int
    payload: bytes
    clip_nanos: int


@dataclass(frozen=True, slots=True)
class LoopedClock:
    """The times of a repeated clip. `offsets` are the clip's timestamps within one loop of `loop_nanos`."""

    offsets: Sequence[int]
    loop_nanos: int

    def __post_init__(self) -> None:
        if not self.offsets or self.offsets[0] != 0 or list(self.offsets) != sorted(set(self.offsets)):
            raise ValueError("a loop's timestamps start at 0 and rise; decode the clip again")
        if self.loop_nanos <= self.offsets[-1]:
            raise ValueError(f"a loop of {self.loop_nanos} ns is over before its last item, at {self.offsets[-1]} ns")

    def offset(self, n: int) -> int:
        """Return the nanoseconds from the start to the nth item."""
        loops, within = divmod(n, len(self.offsets))
        return loops * self.loop_nanos + self.offsets[within]

    def end(self, n: int) -> int:
        """Return the nanoseconds from the start to the end of the nth item, where the next one begins."""
        return self.offset(n + 1)

    def count_before(self, nanos: int) -> int:
        """Return how many items begin in the first `nanos` nanoseconds."""
        if nanos <= 0:
            return 0
        loops, rest = divmod(nanos - 1, self.loop_nanos)
        return loops * len(self.offsets) + bisect_right(self.offsets, rest)


def planned_frames(
    clock: LoopedClock, payloads: Sequence[bytes], start: int, length_nanos: int
) -> Iterator[PlannedItem]:
    """Yield the frames of `length_nanos` from `start` on. Each lasts until the next one."""
    for n in range(clock.count_before(length_nanos)):
        time = start + clock.offset(n)
        within = n % len(payloads)
        yield PlannedItem(
            time=time,
            duration=clock.end(n) - clock.offset(n),
            due=time,
            payload=payloads[within],
            clip_nanos=clock.offsets[within],
        )


def planned_blocks(
    samples: NDArray[np.int16], rate_hz: int, block_nanos: int, start: int, length_nanos: int
) -> Iterator[PlannedItem]:
    """Yield blocks of looped sound, due at their end.

    `samples` is exactly one loop; it need not be a whole number of blocks. Raises ValueError if a block is not a whole
    number of samples.
    """
    block_samples, remainder = divmod(block_nanos * rate_hz, 1_000_000_000)
    if remainder or not block_samples:
        raise ValueError(f"blocks of {block_nanos} ns are no whole number of samples at {rate_hz} Hz")
    for n in range(length_nanos // block_nanos):
        first = n * block_samples
        block = np.take(samples, range(first, first + block_samples), mode="wrap")
        time = start + n * block_nanos
        yield PlannedItem(
            time=time,
            duration=block_nanos,
            due=time + block_nanos,
            payload=block.astype("<i2").tobytes(),
            clip_nanos=(first % len(samples)) * 1_000_000_000 // rate_hz,
        )
