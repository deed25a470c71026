"""The payloads of publishers and their times: at full speed within a bound, or at a fixed rate."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator

from stampede_rt_bench.workloads.interface import Step, WorkloadNeeds
from stampede_rt_bench.workloads.run_counters import RunCounters

SENT = struct.Struct("<Q")  # the time at which a payload was sent, by the monotonic clock of this machine
PAUSE_SECONDS = 0.0002
STALLED_SECONDS = 1.0
RING_BYTES_MAX = 16 << 20
BATCH_BYTES, BATCH_ITEMS_MAX, BATCH_ITEMS_MIN = 1 << 20, 1000, 4
WINDOW_BYTES, WINDOW_ITEMS_MAX, WINDOW_ITEMS_MIN = 8 << 20, 50_000, 32
ROOM_FACTOR = 4


def needs_of(item_bytes: int, items_min: int = 0, *, readers: int = 1, keeps: bool = False) -> WorkloadNeeds:
    """Return the needs of a workload: room for four times the items in flight, so that no system must drop items."""
    window = window_items(item_bytes)
    batch = max(BATCH_ITEMS_MIN, min(BATCH_ITEMS_MAX, BATCH_BYTES // item_bytes))
    items_max = max(items_min, ROOM_FACTOR * window)
    return WorkloadNeeds(item_bytes=item_bytes, items_max=items_max, batch_items=batch, readers=readers, keeps=keeps)


def window_items(item_bytes: int) -> int:
    """Return the number of items that may be published and not yet read."""
    return max(WINDOW_ITEMS_MIN, min(WINDOW_ITEMS_MAX, WINDOW_BYTES // item_bytes))


def at_full_speed(progress: RunCounters, needs: WorkloadNeeds, deadline_s: float) -> Iterator[Step]:
    """Yield prepared batches of payloads, and wait while a window of them is unread.

    If no item is read for a second, because items were lost, it yields one more batch.
    """
    ring = _batches(needs)
    window, sent, turn = window_items(needs.item_bytes), 0, 0
    moved_s, seen = time.monotonic(), 0
    while not progress.has_stopped(deadline_s):
        received = progress.received_by_each()
        if received != seen:
            moved_s, seen = time.monotonic(), received
        if sent - received >= window and time.monotonic() - moved_s < STALLED_SECONDS:
            yield PAUSE_SECONDS
            continue
        moved_s = time.monotonic() if sent - received >= window else moved_s
        yield ring[turn % len(ring)]
        sent, turn = sent + needs.batch_items, turn + 1
        progress.set_published(sent)


def _batches(needs: WorkloadNeeds) -> list[list[bytes]]:
    count = max(2, min(64, RING_BYTES_MAX // (needs.batch_items * needs.item_bytes)))
    return [
        [bytes([number % 251]) * needs.item_bytes for number in range(first, first + needs.batch_items)]
        for first in range(0, count * needs.batch_items, needs.batch_items)
    ]


def at_rate(
    progress: RunCounters, item_bytes: int, per_second: float, deadline_s: float, items_total: int = 0
) -> Iterator[Step]:
    """Yield one payload whenever it is due, with its sending time. A late payload is sent immediately.

    Ends after `items_total` payloads, unless that is 0.
    """
    filler = bytes(item_bytes - SENT.size)
    begun_s, sent = time.monotonic(), 0
    while not progress.has_stopped(deadline_s) and (sent < items_total or not items_total):
        left_s = begun_s + sent / per_second - time.monotonic()
        if left_s > 0:
            yield left_s
            continue
        yield [SENT.pack(time.monotonic_ns()) + filler]
        sent += 1
        progress.set_published(sent)
