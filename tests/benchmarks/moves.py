"""Many moves of a channel and a queue under load, and their effects on producers and readers.

`python -m tests.benchmarks.moves`, or `make bench-moves`. The load: a producer of 30 frames of 18 KB a second, with
subscriptions, gets that wait for the next frame, and a stream of cut events of a group with another channel; a queue
with a producer, and a taker that holds leases all the time. Prints a Markdown table of the pauses of each producer and
reader, and the names of the producers and readers that saw an item twice or not at all. A pause of a reader is the
longest time between two items around a move, less the time between two puts.
"""

from __future__ import annotations

import argparse
import itertools
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import stampede_rt as st
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

FRAME = bytes(18_000)
PERIOD_S = 1 / 30
HOSTS = ("h2", "h3", "h1")
LEASED = 4  # the messages that the taker always holds
Span = tuple[float, float]


class SeenLog:
    """The seqs that one reader or producer has seen, and when."""

    def __init__(self, run: Callable[[SeenLog], None]) -> None:
        self.seqs: list[int] = []
        self.times_s: list[float] = []
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=run, args=(self,), daemon=True)
        self.thread.start()

    def note(self, seq: int) -> None:
        self.seqs.append(seq)
        self.times_s.append(time.monotonic())

    def pause_s(self, span: Span) -> float:
        """The longest pause within a move, and until the next item after it."""
        begun_s, over_s = span
        times = [one for one in self.times_s if begun_s - 2 * PERIOD_S <= one <= over_s + 1]
        return max((later - one for one, later in itertools.pairwise(times)), default=0.0) - PERIOD_S

    def is_whole(self, last: int) -> bool:
        """Whether each item from the first one to `last` came once, in order."""
        return [one for one in self.seqs if one <= last] == [*range(self.seqs[0], last + 1)]

    def stop(self) -> None:
        self.stopped.set()
        self.thread.join(20)


def producing(put: Callable[[int], int]) -> Callable[[SeenLog], None]:
    def run(seen: SeenLog) -> None:
        due_s = time.monotonic()
        while not seen.stopped.wait(max(0.0, due_s - time.monotonic())):
            seen.note(put(len(seen.seqs)))
            due_s += PERIOD_S

    return run


def subscribing(subscription: Any) -> Callable[[SeenLog], None]:
    def run(seen: SeenLog) -> None:
        for item in subscription:
            seen.note(item.seq)

    return run


def following_cuts(subscription: Any, channel: Any) -> Callable[[SeenLog], None]:
    def run(seen: SeenLog) -> None:
        for cut in subscription:
            for item in (*cut.late[channel], *cut[channel]):
                seen.note(item.seq)

    return run


def getting(channel: Any) -> Callable[[SeenLog], None]:
    def run(seen: SeenLog) -> None:
        last = channel.newest()
        while not seen.stopped.is_set():
            for item in channel.get(st.OLDEST, 2**62, after=last, timeout=1):
                seen.note(item.seq)
                last = item

    return run


def taking(queue: Any) -> Callable[[SeenLog], None]:
    def run(seen: SeenLog) -> None:
        leased: deque[Any] = deque()
        while not seen.stopped.is_set():
            message = queue.get(timeout=0.2)
            if message is not None:
                seen.note(int(message.payload))
                leased.append(message)
            if len(leased) > LEASED:
                leased.popleft().ack()
        for message in leased:
            message.ack()

    return run


class Load:
    """All producers and readers. The channel and the queue begin at h1."""

    def __init__(self, rt: Any, readers: int) -> None:
        self.channel = rt.channel("cam", max_items=100_000, host="h1")
        other = rt.channel("mic", max_items=1000, host="h1")
        self.queue = rt.queue("jobs", host="h1", lease="60s")
        group = rt.group("pair", [self.channel, other])
        self.channel.put(FRAME)
        self._streams = [self.channel.subscribe() for _ in range(readers)]
        self._cuts = group.subscribe()
        self.putting = SeenLog(producing(lambda number: int(self.channel.put(FRAME).seq)))
        self.sounds = SeenLog(producing(lambda number: int(other.put(b"a sound").seq)))
        self.jobs = SeenLog(producing(lambda number: int(self.queue.put(b"%d" % number).seq)))
        self.subscribed = [SeenLog(subscribing(one)) for one in self._streams]
        self.got = [SeenLog(getting(self.channel)) for _ in range(readers)]
        self.cut = SeenLog(following_cuts(self._cuts, self.channel))
        self.taken = SeenLog(taking(self.queue))
        readers_of_all = (*self.subscribed, *self.got, self.cut, self.taken)
        wait_until(lambda: all(one.seqs for one in readers_of_all), "all readers have begun")

    def stop(self) -> None:
        """Stop the producers, and then the readers once they have everything."""
        self.putting.stop()
        self.jobs.stop()
        last, jobs = self.putting.seqs[-1], len(self.jobs.seqs)
        wait_until(lambda: all(one.seqs[-1] == last for one in (*self.subscribed, *self.got)), "all frames came")
        wait_until(lambda: len(self.taken.seqs) >= jobs, "all jobs came")
        self.channel.put(FRAME)  # the cut is exclusive: this frame makes the last one visible
        wait_until(lambda: self.cut.seqs[-1] == last, "the cut events have all frames")
        self.sounds.stop()
        for one in (*self.got, self.taken):
            one.stop()
        for stream in (*self._streams, self._cuts):
            stream.close()

    def wrong(self) -> list[str]:
        """The producers and readers that saw an item twice, or not at all."""
        last, jobs = self.putting.seqs[-1], self.jobs.seqs
        frame_counts = {
            "put": [self.putting],
            "subscription": self.subscribed,
            "get": self.got,
            "cut event": [self.cut],
        }
        found = [what for what, those in frame_counts.items() for one in those if not one.is_whole(last)]
        found += [] if self.jobs.is_whole(jobs[-1]) else ["put into the queue"]
        return found + ([] if sorted(self.taken.seqs) == [*range(len(jobs))] else ["take"])


def measure(moves: int, readers: int) -> None:
    """Move the channel and the queue this number of times, and print the table."""
    load = os.getloadavg()[0]
    with running_cluster(hosts=3, supernodes=1) as cluster, st.connect(cluster.address, transport="grpc") as rt:
        all_of = Load(rt, readers)
        channel_moves, queue_moves, held, held_queue = [], [], [], []
        for move in range(moves):
            channel_moves.append(timed(held, lambda: rt.move("cam", HOSTS[move % 3])))  # noqa: B023
            queue_moves.append(timed(held_queue, lambda: rt.move_queue("jobs", HOSTS[move % 3])))  # noqa: B023
        all_of.stop()
        print("| what | p50 | p99 | max |\n| --- | --- | --- | --- |")
        show("puts held, as the new host measures", held)
        show("puts into the channel", pauses([all_of.putting], channel_moves))
        show(f"{readers} subscriptions", pauses(all_of.subscribed, channel_moves))
        show(f"{readers} waiting gets", pauses(all_of.got, channel_moves))
        show("cut events", pauses([all_of.cut], channel_moves))
        show("the queue held, as the new host measures", held_queue)
        show("puts into the queue", pauses([all_of.jobs], queue_moves))
        show("takes from the queue", pauses([all_of.taken], queue_moves))
        wrong = all_of.wrong()
        print(
            f"\n{moves} moves of each, {all_of.putting.seqs[-1]} frames, {len(all_of.jobs.seqs)} jobs; an item twice or"
        )
        print(f"not at all: {', '.join(wrong) or 'nobody'}. {os.cpu_count()} cores, load {load:.1f} before the run.")
        if wrong:
            raise SystemExit(1)


def timed(held: list[float], move: Callable[[], Any]) -> Span:
    """Perform a move. Notes how long it held puts, and returns when it began and ended."""
    begun_s = time.monotonic()
    held.append(move().blackout_nanos / 1e9)
    over_s = time.monotonic()
    time.sleep(0.1)
    return begun_s, over_s


def pauses(those: Iterable[SeenLog], spans: list[Span]) -> list[float]:
    """The pause of each reader or producer at each move."""
    return [one.pause_s(span) for one in those for span in spans]


def show(what: str, pauses_s: list[float]) -> None:
    """Print one row: the median, the 99th percentile and the maximum."""
    in_order = sorted(max(0.0, one) * 1e3 for one in pauses_s)
    p50, p99 = in_order[len(in_order) // 2], in_order[min(len(in_order) - 1, len(in_order) * 99 // 100)]
    print(f"| {what} | {p50:.0f} ms | {p99:.0f} ms | {in_order[-1]:.0f} ms |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moves", type=int, default=100)
    parser.add_argument("--readers", type=int, default=8)
    arguments = parser.parse_args()
    measure(arguments.moves, arguments.readers)
