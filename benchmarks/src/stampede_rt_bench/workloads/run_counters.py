"""Counters that the processes of one run share, independent of the measured system."""

from __future__ import annotations

import ctypes
import time
from multiprocessing.context import ForkServerContext
from typing import Any

_ENDED, _STOPPED, _MEASURED, _PUBLISHED, _READERS = range(5)


class RunCounters:
    """Shared values: whether the run is measured or has ended, and the items of the publisher and of each reader.

    Each value is an aligned word of 8 bytes, which one process writes. After the counts of the readers there is one
    more word for each reader, which says whether that reader is ready.
    """

    def __init__(self, context: ForkServerContext, readers: int) -> None:
        self._words: Any = context.RawArray(ctypes.c_uint64, _READERS + 2 * readers)
        self._readers = readers

    def measure(self, on: bool) -> None:
        """Begin or end the time in which operations and items count."""
        self._words[_MEASURED] = on

    def measured(self) -> bool:
        """Whether operations and items count now."""
        return bool(self._words[_MEASURED])

    def stop_publishing(self) -> None:
        """Tell the publisher, or the only process, to stop."""
        self._words[_STOPPED] = 1

    def end(self) -> None:
        """Tell all processes of the run to stop."""
        self._words[_STOPPED] = self._words[_ENDED] = 1

    def has_stopped(self, deadline_s: float) -> bool:
        """Whether `stop_publishing` or `end` was called, or the monotonic clock has passed the deadline."""
        return bool(self._words[_STOPPED]) or time.monotonic() > deadline_s

    def has_ended(self, deadline_s: float) -> bool:
        """Whether `end` was called, or the monotonic clock has passed the deadline."""
        return bool(self._words[_ENDED]) or time.monotonic() > deadline_s

    def set_published(self, items: int) -> None:
        """Set the number of published items. Only the publisher calls this."""
        self._words[_PUBLISHED] = items

    def published(self) -> int:
        """The number of items that the publisher gave to its client."""
        return int(self._words[_PUBLISHED])

    def set_received(self, reader: int, items: int) -> None:
        """Set the number of items, or operations, of one reader. Only that reader calls this."""
        self._words[_READERS + reader] = items

    def received_by_all(self) -> int:
        """The number of items, or operations, of all readers together."""
        return sum(self._words[_READERS : _READERS + self._readers])

    def received_by_reader(self) -> list[int]:
        """The number of items, or operations, of each reader."""
        return list(self._words[_READERS : _READERS + self._readers])

    def received_by_each(self) -> int:
        """The number of items that the slowest reader has."""
        return int(min(self._words[_READERS : _READERS + self._readers]))

    def set_ready(self, reader: int) -> None:
        """Note that one reader is ready. Only that reader calls this."""
        self._words[_READERS + self._readers + reader] = 1

    def all_ready(self) -> bool:
        """Whether all readers are ready."""
        return all(self._words[_READERS + self._readers :])
