"""The load of a host with open tabs of the live page: `python -m tests.benchmarks.live_page`.

A producer puts 20 channels of 30 items a second of 18 KB. The benchmark prints the share of one core that the host uses
alternately without tabs and with ten tabs. A tab sends the requests of the page, at the pace of the page.
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from statistics import median

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.live_page import LivePage, live_page

CHANNELS, ITEMS_A_SECOND, PAYLOAD_BYTES = 20, 30, 18_000
SHOWN = 6  # the cards that a new tab shows
PAUSE_SECONDS = 0.25
TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tabs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=10.0, help="the time of one measurement")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    with ExitStack() as stack:
        cluster = stack.enter_context(LocalCluster(hosts=1, supernodes=1, durable=False))
        os.environ["STAMPEDE_SECRET_FILE"] = str(cluster.secret_file)
        page = stack.enter_context(live_page(cluster.address))
        ended = threading.Event()
        stack.callback(ended.set)
        names = [f"cam/{number:02}" for number in range(CHANNELS)]
        _run(ended, lambda: _produce(cluster.address, names, ended))
        without, with_tabs = [], []
        for _ in range(arguments.rounds):
            without.append(_share(cluster, arguments.seconds))
            closed = threading.Event()
            for _ in range(arguments.tabs):
                _run(closed, lambda closed=closed: _tab(page, names, closed))
            time.sleep(1.0)  # the first reads of the tracks are not the steady state
            with_tabs.append(_share(cluster, arguments.seconds))
            closed.set()
            time.sleep(1.0)
    extra = [there - here for here, there in zip(without, with_tabs, strict=True)]
    print(f"host without tabs: {median(without):.1f} % of a core ({min(without):.1f} to {max(without):.1f})")
    print(f"{arguments.tabs} tabs add: {median(extra):.1f} % of a core ({min(extra):.1f} to {max(extra):.1f})")


def _run(ended: threading.Event, work: Callable[[], None]) -> None:
    threading.Thread(target=work, daemon=True).start()


def _produce(address: str, names: list[str], ended: threading.Event) -> None:
    with st.connect(address) as rt, ExitStack() as stack:
        producers = [stack.enter_context(rt.channel(name, max_age="10s").producer()) for name in names]
        payload = os.urandom(PAYLOAD_BYTES)
        due = time.monotonic()
        while not ended.is_set():
            for producer in producers:
                producer.put(payload)
            due += 1 / ITEMS_A_SECOND
            time.sleep(max(0.0, due - time.monotonic()))


def _tab(page: LivePage, names: list[str], closed: threading.Event) -> None:
    """Ask as the page does: the overview each second, the time line and the items four times a second."""
    overview_due = 0.0
    while not closed.is_set():
        with suppress(OSError):
            if time.monotonic() >= overview_due:
                overview_due = time.monotonic() + 1.0
                page.ask("overview")
            now = time.time_ns()
            page.ask("timeline", channel=names, width=1000, **{"from": now - 10_000_000_000, "to": now})
            page.ask("at", channel=names[:SHOWN], at="newest")
        closed.wait(PAUSE_SECONDS)


def _share(cluster: LocalCluster, seconds: float) -> float:
    """Return the share of one core, in percent, that the host uses for `seconds`."""
    before, began = _cpu_seconds(cluster.hosts[0].pid), time.monotonic()
    time.sleep(seconds)
    return 100 * (_cpu_seconds(cluster.hosts[0].pid) - before) / (time.monotonic() - began)


def _cpu_seconds(pid: int) -> float:
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_A_SECOND


if __name__ == "__main__":
    main()
