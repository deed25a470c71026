"""The cost of a put for a client with many channels:

`python -m tests.benchmarks.many_puts [--channels 1024] [--awaited]`.

One thread, or one event loop, puts an item into each channel in turn, four times. The channels are opened before the
measurement.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import threading
import time

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_bench.clusters import running
from stampede_rt_bench.tables import Table

STEPS = (1, 100, 400, 1024)
ROUNDS = 3
PAYLOAD = b"x" * 64


def blocking(address: str, counts: list[int], table: Table) -> None:
    """Measure puts through the blocking client. Adds one row to `table` for each number of channels."""
    with st.connect(address) as rt:
        channels = [rt.channel(f"many/{number}", max_items=10) for number in range(counts[-1])]
        for count in counts:
            took_s, before_s = [], time.process_time()
            for channel in channels[:count] * (ROUNDS + 1):
                began_s = time.perf_counter()
                channel.put(PAYLOAD)
                took_s.append(time.perf_counter() - began_s)
            cpu_s = (time.process_time() - before_s) / len(took_s)
            add(table, count, took_s[count:], cpu_s, threading.active_count())


async def awaited(address: str, counts: list[int], table: Table) -> None:
    """Like `blocking`, but through the client on asyncio."""
    async with await aio.connect(address) as rt:
        channels = [await rt.channel(f"many/{number}", max_items=10) for number in range(counts[-1])]
        for count in counts:
            took_s, before_s = [], time.process_time()
            for channel in channels[:count] * (ROUNDS + 1):
                began_s = time.perf_counter()
                await channel.put(PAYLOAD)
                took_s.append(time.perf_counter() - began_s)
            cpu_s = (time.process_time() - before_s) / len(took_s)
            add(table, count, took_s[count:], cpu_s, len(asyncio.all_tasks()))


def add(table: Table, count: int, took_s: list[float], cpu_s: float, threads: int) -> None:
    """Add a row. The first round binds the channels, and counts for the CPU time only."""
    median_us = statistics.median(took_s) * 1e6
    table.rows.append([f"{count:,}", f"{median_us:,.0f}", f"{cpu_s * 1e6:,.0f}", f"{threads}"])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--channels", type=int, default=STEPS[-1], help="the most channels (default: 1024)")
    parser.add_argument("--awaited", action="store_true", help="use the client on asyncio")
    arguments = parser.parse_args()
    counts = [*(step for step in STEPS if step < arguments.channels), arguments.channels]
    what = "tasks" if arguments.awaited else "threads"
    table = Table(["channels", "a put, median us", "client CPU a put, us", what])
    with running(hosts=1) as address:
        if arguments.awaited:
            asyncio.run(awaited(address, counts, table))
        else:
            blocking(address, counts, table)
    table.print()


if __name__ == "__main__":
    main()
