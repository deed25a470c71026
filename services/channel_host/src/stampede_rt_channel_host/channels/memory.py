"""One bound for what all channels and queues of a host keep, and what was refused for want of room."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.overload import Overload

logger = logging.getLogger(__name__)


class MemoryBudget:
    """Each channel and queue reports its memory as it changes, and the budget adds it up. The cost of a question does
    not grow with their number. The budget calls `reclaim` before it refuses a claim; `reclaim` frees a bounded part of
    the outdated items."""

    def __init__(
        self,
        bytes_max: int,
        reclaim: Callable[[], None] = lambda: None,
        steady_nanos: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.used_bytes = 0
        self.bytes_max = bytes_max
        self.overload = Overload()
        self._reclaim = reclaim
        self._steady_nanos = steady_nanos

    def claim(self, wanted_bytes: int) -> None:
        """Before something is stored, which is charged afterwards. Raises Overloaded if there is no room for it."""
        if self.used_bytes + wanted_bytes <= self.bytes_max:
            return
        self._reclaim()
        if self.used_bytes + wanted_bytes > self.bytes_max:
            raise Overloaded(
                f"the host's channels and queues hold {self.used_bytes} bytes together, of at most {self.bytes_max} "
                "(--memory-bytes-max); put again later, tighten retention, or use another host",
                metadata={"memory_bytes_max": str(self.bytes_max)},
            )

    def refused(self, name: str, items: int, error: Overloaded) -> None:
        """Items for the channel or queue of that name were refused: counted, and logged every few seconds at most."""
        untold = self.overload.note(items, self._steady_nanos())
        if untold is not None:
            logger.warning("puts are refused", extra={"items": untold, "last_for": name, "why": error.message})

    def refused_ago_nanos(self) -> int | None:
        """How long ago items were refused last; None: none were."""
        return self.overload.ago_nanos(self._steady_nanos())


class Charge:
    """The memory that one channel or queue is charged."""

    __slots__ = ("_budget", "_bytes")

    def __init__(self, budget: MemoryBudget) -> None:
        self._budget = budget
        self._bytes = 0

    def set(self, footprint_bytes: int) -> None:
        """So much is kept now."""
        self._budget.used_bytes += footprint_bytes - self._bytes
        self._bytes = footprint_bytes
