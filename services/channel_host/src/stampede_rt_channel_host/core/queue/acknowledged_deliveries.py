"""The latest acknowledged deliveries and their takers, so that a repeated acknowledgement succeeds. Pure.

Delivery ids are consecutive, so arrays hold their takers and times. Each delivery takes 16 bytes instead of an object.
"""

from __future__ import annotations

from array import array
from collections import OrderedDict
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

KEPT_NANOS = 600_000_000_000  # the time that a queue remembers an acknowledgement
_IDS_PER_CHUNK = 256  # a chunk holds the acknowledgements of this many consecutive delivery ids
BYTES_PER_CHUNK = 16 * _IDS_PER_CHUNK
CHUNKS_MAX = 2**14
"""A queue remembers at most 4 million deliveries, in 64 MiB.

If takers acknowledge more than 7,000 deliveries a second, the queue remembers each for less than 10 minutes.
"""


class AcknowledgedDelivery(NamedTuple):
    """A delivery, its taker, and the time of the acknowledgement."""

    delivery_id: int
    taker_id: int
    time: int


class _Chunk:
    """The takers and times of _IDS_PER_CHUNK consecutive deliveries."""

    __slots__ = ("takers", "times")

    def __init__(self) -> None:
        self.takers = array("Q", bytes(8 * _IDS_PER_CHUNK))  # 0: not acknowledged; no taker has the id 0
        self.times = array("q", bytes(8 * _IDS_PER_CHUNK))


class AcknowledgedDeliveries:
    """The acknowledgements of the last 10 minutes. `now` never goes back."""

    def __init__(self, *, chunks_max: int = CHUNKS_MAX) -> None:
        self._chunks_max = chunks_max
        # chunk number -> chunk; the chunk with the latest acknowledgement comes last
        self._chunks: OrderedDict[int, _Chunk] = OrderedDict()
        self._latest: dict[int, int] = {}  # chunk number -> the time of its latest acknowledgement

    @property
    def footprint_bytes(self) -> int:
        """The bytes that these acknowledgements take in the host's memory."""
        return len(self._chunks) * BYTES_PER_CHUNK

    def record(self, delivery_id: int, taker_id: int, now: int) -> None:
        """Note that the taker has acknowledged the delivery."""
        number, offset = divmod(delivery_id, _IDS_PER_CHUNK)
        chunk = self._chunks.get(number)
        if chunk is None:
            chunk = self._chunks[number] = _Chunk()
        chunk.takers[offset], chunk.times[offset] = taker_id, now
        self._chunks.move_to_end(number)
        self._latest[number] = now
        self._forget(now)

    def knows(self, delivery_id: int, taker_id: int, now: int) -> bool:
        """Whether this taker acknowledged the delivery within the last 10 minutes."""
        number, offset = divmod(delivery_id, _IDS_PER_CHUNK)
        chunk = self._chunks.get(number)
        return chunk is not None and chunk.takers[offset] == taker_id and chunk.times[offset] > now - KEPT_NANOS

    def latest(self, chunks_max: int | None = None) -> AcknowledgedDeliveries:
        """A copy of the latest chunks, at most `chunks_max`, for `all`. A chunk has up to 256 acknowledgements."""
        copied = AcknowledgedDeliveries()
        for number, chunk in islice(reversed(self._chunks.items()), chunks_max):
            own = copied._chunks[number] = _Chunk()
            own.takers, own.times = chunk.takers[:], chunk.times[:]
            copied._chunks.move_to_end(number, last=False)
        return copied

    def all(self, now: int) -> Iterator[AcknowledgedDelivery]:
        """The acknowledgements of the last 10 minutes, by chunks. The chunk with the latest one comes last."""
        for number, chunk in self._chunks.items():
            for offset, taker_id in enumerate(chunk.takers):
                if taker_id and chunk.times[offset] > now - KEPT_NANOS:
                    yield AcknowledgedDelivery(number * _IDS_PER_CHUNK + offset, taker_id, chunk.times[offset])

    def _forget(self, now: int) -> None:
        while self._chunks:
            oldest = next(iter(self._chunks))
            if len(self._chunks) <= self._chunks_max and self._latest[oldest] > now - KEPT_NANOS:
                return
            del self._chunks[oldest], self._latest[oldest]
