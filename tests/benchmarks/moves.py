"""Moves of one channel in a row under load: what producers and readers notice. `python -m tests.benchmarks.moves`.

The load: a producer of 30 frames of 18 KB a second, subscriptions, gets that wait for the next frame, and a group with
another channel. Prints the pauses of each, and what was lost or came twice. A pause of a reader is the longest time
between two frames around a move, less the time between two frames.
"""

from __future__ import annotations

import argparse
import itertools
import threading
import time
from collections.abc import Callable
from typing import Any

import stampede_rt as st
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

FRAME = bytes(18_000)
PERIOD_S = 1 / 30
HOSTS = ("h2", "h3", "h1")


class Seen:
    """The frames that one reader or the producer has seen, and when."""

    def __init__(self, run: Callable[[Seen], None]) -> None:
        self.seqs: list[int] = []
        self.times_s: list[float] = []
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=run, args=(self,), daemon=True)
        self.thread.start()

    def note(self, seq: int) -> None:
        self.seqs.append(seq)
        self.times_s.append(time.monotonic())

    def pause_s(self, begun_s: float, over_s: float) -> float:
        """The longest pause within a move, and until the next frame after it."""
        times = [one for one in self.times_s if begun_s - 2 * PERIOD_S <= one <= over_s + 1]
        return max((later - one for one, later in itertools.pairwise(times)), default=0.0) - PERIOD_S


def producing(channel: Any) -> Callable[[Seen], None]:
    def run(seen: Seen) -> None:
        due_s = time.monotonic()
        while not seen.stopped.wait(max(0.0, due_s - time.monotonic())):
            seen.note(channel.put(FRAME).seq)
            due_s += PERIOD_S

    return run


def subscribing(subscription: Any) -> Callable[[Seen], None]:
    def run(seen: Seen) -> None:
        for item in subscription:
            seen.note(item.seq)

    return run


def getting(channel: Any) -> Callable[[Seen], None]:
    def run(seen: Seen) -> None:
        last = channel.newest()
        while not seen.stopped.is_set():
            for item in channel.get(st.OLDEST, 2**62, after=last, timeout=1):
                seen.note(item.seq)
                last = item

    return run


def measure(moves: int, readers: int) -> None:
    """Move the channel so many times, and print the tables."""
    with running_cluster(hosts=3, supernodes=1) as cluster, st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel("cam", max_items=100_000, host="h1")
        rt.group("pair", [channel, rt.channel("mic", host="h1")])
        channel.put(FRAME)
        subscriptions = [channel.subscribe() for _ in range(readers)]
        producer = Seen(producing(channel))
        subscribed = [Seen(subscribing(one)) for one in subscriptions]
        got = [Seen(getting(channel)) for _ in range(readers)]
        wait_until(lambda: all(one.seqs for one in (*subscribed, *got)), "all readers have begun")
        spans, held = [], []
        for move in range(moves):
            begun_s = time.monotonic()
            held.append(rt.move(channel, HOSTS[move % 3]).blackout_nanos / 1e9)
            spans.append((begun_s, time.monotonic()))
            time.sleep(0.1)
        producer.stopped.set()
        producer.thread.join(20)
        last = producer.seqs[-1]
        wait_until(lambda: all(one.seqs[-1] == last for one in (*subscribed, *got)), "all readers have all frames")
        for one in (*got, *subscribed):
            one.stopped.set()
        for subscription in subscriptions:
            subscription.close()
        for one in got:
            one.thread.join(20)
        show("puts held (as the new host measures)", held)
        show("put", [producer.pause_s(*span) for span in spans])
        show("subscriptions", [one.pause_s(*span) for one in subscribed for span in spans])
        show("waiting gets", [one.pause_s(*span) for one in got for span in spans])
        wrong = sum(one.seqs != [*range(one.seqs[0], last + 1)] for one in (producer, *subscribed, *got))
        print(f"{moves} moves, {last} frames: {wrong} of {2 * readers + 1} saw a frame twice, or not at all")


def show(what: str, pauses_s: list[float]) -> None:
    """Print one row: the median, the 99th percentile and the maximum."""
    in_order = sorted(max(0.0, one) * 1e3 for one in pauses_s)
    p50, p99 = in_order[len(in_order) // 2], in_order[min(len(in_order) - 1, len(in_order) * 99 // 100)]
    print(f"{what:40} p50 {p50:7.1f} ms  p99 {p99:7.1f} ms  max {in_order[-1]:7.1f} ms")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moves", type=int, default=100)
    parser.add_argument("--readers", type=int, default=8)
    arguments = parser.parse_args()
    measure(arguments.moves, arguments.readers)
