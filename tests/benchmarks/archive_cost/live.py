"""The times from a put to its reader: with and without an archive, and during long reads of the archive."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import stampede_rt as st
from tests.benchmarks.archive_cost.figures import heading, percentile, ratios, row, spread
from tests.benchmarks.archive_cost.reading import filled

HZ, ITEMS = 500, 2000
LONG_ITEMS = 500_000


def read_on(address: str, name: str) -> None:
    """Read a whole channel again and again."""
    with st.connect(address) as rt:
        channel = rt.channel(name, create=False)
        while True:
            channel.get(st.OLDEST, st.NOW)


@contextmanager
def long_reads(address: str, name: str) -> Iterator[None]:
    """Another process reads the channel during the context. With an empty name no process reads."""
    reader = multiprocessing.get_context("spawn").Process(target=read_on, args=(address, name), daemon=True)
    if name:
        reader.start()
        time.sleep(1)  # until the reader reads
    yield
    if name:
        reader.kill()
        reader.join()


def times_of(channel: st.Channel) -> list[float]:
    """The microseconds from each put to the reader."""
    taken: list[float] = []
    with channel.subscribe() as items:

        def read() -> None:
            for _ in range(ITEMS):
                put = int(next(items).payload)
                taken.append((time.monotonic_ns() - put) / 1e3)

        reader = threading.Thread(target=read)
        reader.start()
        due = time.monotonic()
        for _ in range(ITEMS):
            due += 1 / HZ
            time.sleep(max(0.0, due - time.monotonic()))
            channel.put(b"%d" % time.monotonic_ns())
        reader.join()
    return taken


def living(rt: st.Connection, address: str, rounds: int) -> None:
    """Print the times of all settings. Each is compared with the setting named in its row."""
    filled(rt, "cost/long/archive", LONG_ITEMS, archive="forever", max_items=1000)
    filled(rt, "cost/long/memory", LONG_ITEMS, max_items=10**6, max_bytes=2**30)
    settings = {
        "in memory": ("", "", ""),
        "recorded": ("forever", "", "in memory"),
        "recorded, beside a reader of 500,000 items in memory": ("forever", "cost/long/memory", ""),
        "recorded, beside a reader of 500,000 items in the archive": (
            "forever", "cost/long/archive", "recorded, beside a reader of 500,000 items in memory",
        ),
    }  # fmt: skip
    found: dict[str, list[list[float]]] = {name: [] for name in settings}
    for number in range(rounds):
        for name, (archive, beside, _) in settings.items():
            policy = {"archive": archive} if archive else {}
            channel = rt.channel(f"cost/live/{archive}{beside}/{number}", max_age="10s", **policy)
            with long_reads(address, beside):
                found[name].append(times_of(channel))
    heading("from put to reader", "median", "p99", "p99 of", "ratio of p99")
    for name, (_, _, other) in settings.items():
        lates = [percentile(one, 0.99) for one in found[name]]
        ratio = ratios(lates, [percentile(one, 0.99) for one in found[other]]) if other else ""
        middles = [percentile(one, 0.5) for one in found[name]]
        row(name, spread(middles, ".0f", " us"), spread(lates, ".0f", " us"), other, ratio)
