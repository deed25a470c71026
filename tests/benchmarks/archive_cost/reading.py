"""The times of reads from archives of growing sizes, and from memory."""

from __future__ import annotations

import os
import random
from typing import Any

import stampede_rt as st
from tests.benchmarks.archive_cost.figures import heading, percentile, row, seconds_of, spread
from tests.support.waiting import wait_until

PAYLOAD = os.urandom(64)
AT_TIMES, INTERVALS, INTERVAL_ITEMS = 400, 5, 100_000
US = 1000


def filled(
    rt: st.Connection, name: str, items: int, *, one_by_one: bool = False, **policy: Any
) -> tuple[st.Channel, int]:
    """A channel with this number of items, a microsecond apart, and the time of the first one. `one_by_one`: each item
    is a run of its own.
    """
    channel = rt.channel(name, **policy)
    began = channel.stats().host_time - (items + 1) * US
    with channel.producer() as producer:
        put = channel.put if one_by_one else producer.put
        for number in range(items):
            put(PAYLOAD, time=began + number * US)
    if "archive" in policy:
        wait_until(lambda: channel.stats().held <= 1000, within_seconds=600)
    return channel, began


def reading(rt: st.Connection, largest: int) -> None:
    """Print the times of reads."""
    heading("items", "at(t), median", "at(t), p99", f"interval of {INTERVAL_ITEMS:,}, thousand items/s")
    least = INTERVAL_ITEMS + 2000
    channel, began = filled(rt, "cost/at/memory", least, max_items=10**6, max_bytes=2**30)
    row(f"{INTERVAL_ITEMS:,} in memory", *read_figures(channel, began, least))
    channel, began = filled(rt, "cost/at/single", least, one_by_one=True, max_items=10**6, max_bytes=2**30)
    row(f"{INTERVAL_ITEMS:,} in memory, put one by one", *read_figures(channel, began, least))
    row("the same, by a subscription", "", "", spread(subscribed_rates(channel, began), ".0f"))
    channel, began = filled(rt, "cost/at/archived", least, one_by_one=True, archive="forever", max_items=1000)
    row(f"{INTERVAL_ITEMS:,} in the archive, put one by one", *read_figures(channel, began, least))
    size = 10**5
    while size <= largest:
        items = max(size, least)  # the last 1000 are in memory
        channel, began = filled(rt, f"cost/at/{size}", items, archive="forever", max_items=1000)
        row(f"{size:,} in the archive", *read_figures(channel, began, items))
        size *= 10


def subscribed_rates(channel: st.Channel, began: int) -> list[float]:
    """The speeds of subscriptions that begin in the past, in thousand items a second."""

    def read() -> None:
        left = INTERVAL_ITEMS
        with channel.subscribe(start=began) as items:
            for batch in items.batches():
                left -= len(batch)
                if left <= 0:
                    return

    return [INTERVAL_ITEMS / seconds_of(read) / 1e3 for _ in range(INTERVALS)]


def read_figures(channel: st.Channel, began: int, size: int) -> tuple[str, str, str]:
    """The times of reads by time, and the speed of reads of an interval. The reads look at each item."""
    draw, taken = random.Random(1), []
    for _ in range(AT_TIMES):
        at = began + draw.randrange(size - 2000) * US
        taken.append(seconds_of(lambda at=at: channel.at(at)) * 1e3)
    start = began + (size - 2000 - INTERVAL_ITEMS) // 2 * US

    def read() -> None:
        items = channel.get(start, start + INTERVAL_ITEMS * US, bounds="[)")
        assert sum(len(one.payload) for one in items) == INTERVAL_ITEMS * len(PAYLOAD)

    read()  # brings the files into the page cache
    rates = [INTERVAL_ITEMS / seconds_of(read) / 1e3 for _ in range(INTERVALS)]
    return f"{percentile(taken, 0.5):.2f} ms", f"{percentile(taken, 0.99):.2f} ms", spread(rates, ".0f")
