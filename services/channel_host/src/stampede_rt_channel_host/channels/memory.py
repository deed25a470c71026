"""One bound for what all channels and queues of a host keep. Pure."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.errors import Overloaded


class MemoryBudget:
    """What is kept is told by each channel and queue as it changes, and added up: asking costs the same however many
    they are. `reclaim` is called before a claim is refused; it frees what time has outdated, a bounded part."""

    def __init__(self, bytes_max: int, reclaim: Callable[[], None] = lambda: None) -> None:
        self.used_bytes = 0
        self._bytes_max = bytes_max
        self._reclaim = reclaim

    def claim(self, wanted_bytes: int) -> None:
        """Before something is stored, which is charged afterwards. Raises Overloaded if there is no room for it."""
        if self.used_bytes + wanted_bytes <= self._bytes_max:
            return
        self._reclaim()
        if self.used_bytes + wanted_bytes > self._bytes_max:
            raise Overloaded(
                f"the host's channels and queues hold {self.used_bytes} bytes together and {self._bytes_max} are "
                "their most (--memory-bytes-max); put again when items have gone, tighten retention, or use "
                "another host",
                metadata={"memory_bytes_max": str(self._bytes_max)},
            )


class Charge:
    """What one channel or queue is charged."""

    __slots__ = ("_budget", "_bytes")

    def __init__(self, budget: MemoryBudget) -> None:
        self._budget = budget
        self._bytes = 0

    def set(self, footprint_bytes: int) -> None:
        """So much is kept now."""
        self._budget.used_bytes += footprint_bytes - self._bytes
        self._bytes = footprint_bytes
