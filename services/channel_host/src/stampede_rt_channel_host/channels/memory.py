"""One bound for the items of all channels and queues of a host. Pure."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES

_REMEASURE_NANOS = 10_000_000


class MemoryBudget:
    """Payloads and 64 bytes for each item, as retention counts them.

    Between two measurements what was claimed is added and nothing that went is taken off, so the estimate never lies
    below the truth; when it reaches the bound all is measured, at most 100 times a second.
    """

    def __init__(self, bytes_max: int, measure: Callable[[], int], steady_nanos: Callable[[], int]) -> None:
        self._bytes_max = bytes_max
        self._measure = measure
        self._steady_nanos = steady_nanos
        self._estimate = 0
        self._measured_at: int | None = None

    def claim(self, payload_bytes: int, items: int) -> None:
        """Before items are stored. Raises Overloaded if there is no room for them."""
        wanted = payload_bytes + items * ITEM_OVERHEAD_BYTES
        if self._estimate + wanted > self._bytes_max:
            self._measure_again()
            if self._estimate + wanted > self._bytes_max:
                raise Overloaded(
                    f"the host's channels and queues hold {self._estimate} bytes together and {self._bytes_max} are "
                    "their most (--memory-bytes-max); put again when items have gone, tighten retention, or use "
                    "another host",
                    metadata={"memory_bytes_max": str(self._bytes_max)},
                )
        self._estimate += wanted

    def _measure_again(self) -> None:
        now = self._steady_nanos()
        if self._measured_at is None or now - self._measured_at >= _REMEASURE_NANOS:
            self._measured_at = now
            self._estimate = self._measure()
