"""The memory of held items besides their payload, by the size of the put runs. Measures each size in a new process."""

from __future__ import annotations

import multiprocessing
import os
from pathlib import Path

from stampede_rt_bench.charts import Axes, draw_lines
from stampede_rt_bench.filling import filled_channel
from stampede_rt_bench.measuring import PAYLOAD_BYTES, Effort, Spread, quiet
from stampede_rt_bench.tables import Table, number, spread

HELD_ITEMS_MIN, HELD_ITEMS_MAX = 100_000, 1_000_000
RUNS_OF_ITEMS = (1, 8, 64, 256)
GOAL_BYTES = 350


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the chart of bytes over the payload for each held item."""
    held = max(HELD_ITEMS_MIN, min(effort.items_max, HELD_ITEMS_MAX))
    points = [
        (run_items, Spread.of([_in_fresh_process(held, run_items) for _ in range(min(effort.runs, 3))]))
        for run_items in RUNS_OF_ITEMS
    ]
    title = f"Memory over the payload, {held:,} held items of {PAYLOAD_BYTES} B"
    draw_lines(chart, Axes(title=title, x="items in each put run", y="bytes per item"), {"resident memory": points})
    table = Table(["items in a run", "bytes over the payload, an item"])
    table.rows = [[number(run_items), spread(value, 0)] for run_items, value in points]
    table.notes = [
        f"Resident memory with {held:,} items, minus resident memory without items, minus the payloads (goal: "
        f"{GOAL_BYTES})."
    ]
    return table


def _in_fresh_process(held: int, run_items: int) -> float:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(bytes_over_payload, (held, run_items))


def bytes_over_payload(held: int, run_items: int) -> float:
    """Return the growth of this process for each item, without its payload."""
    with quiet():
        warmed = filled_channel(1000, run_items=run_items)  # so that imports and caches do not count
        before = _resident_bytes()
        channel = filled_channel(held, run_items=run_items)
        grown = _resident_bytes() - before
    if channel.counters(0).held != held or warmed.counters(0).held != 1000:
        raise AssertionError("items were collected while they were counted")
    return grown / held - PAYLOAD_BYTES


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")
