"""The workloads: the tasks with which the benchmark compares systems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Kind = Literal["put", "newest", "interval", "stream", "frames", "latency"]
FRAMES_PER_SECOND = 30
INTERVAL_ITEMS = 1000
READERS = (8, 16, 32, 64)
RATES = (30, 300, 3000)
SMALL, MEDIUM, LARGE = 64, 18_000, 300_000


@dataclass(frozen=True, kw_only=True)
class Workload:
    """One workload. `rate` is items a second, 0 for full speed; `items` is the number of items that one operation
    moves.

    The publisher ends by itself after `items_total` items; 0: it does not.
    """

    name: str
    title: str
    kind: Kind
    item_bytes: int
    readers: int = 1
    rate: float = 0
    items: int = 1
    items_total: int = 0

    @property
    def is_operation(self) -> bool:
        """Whether one process repeats an operation.

        Otherwise there is a process for the producer and one for each reader.
        """
        return self.kind in ("put", "newest", "interval")


def size(item_bytes: int) -> str:
    """Return the size as a text, such as `64 B` or `18 KB`."""
    return f"{item_bytes} B" if item_bytes < 1000 else f"{item_bytes // 1000} KB"


def workloads(readers: Sequence[int] = READERS) -> list[Workload]:
    """Return all workloads. `readers`: the numbers of readers for the workloads with frames."""
    return [
        Workload(name="put", title="one acknowledged put of 64 B", kind="put", item_bytes=SMALL),
        Workload(name="newest", title="newest item of 18 KB", kind="newest", item_bytes=MEDIUM),
        Workload(
            name="interval",
            title=f"interval get of {INTERVAL_ITEMS} items of 64 B",
            kind="interval",
            item_bytes=SMALL,
            items=INTERVAL_ITEMS,
        ),
        *(
            Workload(
                name=f"stream-{size(item_bytes).replace(' ', '').lower()}",
                title=f"put to subscriber, {size(item_bytes)}",
                kind="stream",
                item_bytes=item_bytes,
            )
            for item_bytes in (SMALL, MEDIUM, LARGE)
        ),
        *(
            Workload(
                name=f"latency-{rate}",
                title=f"put to reader, 64 B, {rate} items/s",
                kind="latency",
                item_bytes=SMALL,
                rate=rate,
            )
            for rate in RATES
        ),
        *(frames(item_bytes, count) for item_bytes in (MEDIUM, LARGE) for count in readers),
    ]


def frames(item_bytes: int, readers: int, items_total: int = 0) -> Workload:
    """Return the workload that sends a camera's frames to `readers` readers."""
    return Workload(
        name=f"frames-{size(item_bytes).replace(' ', '').lower()}-{readers}",
        title=f"{readers} readers of {size(item_bytes)} at {FRAMES_PER_SECOND} fps",
        kind="frames",
        item_bytes=item_bytes,
        readers=readers,
        rate=FRAMES_PER_SECOND,
        items_total=items_total,
    )
