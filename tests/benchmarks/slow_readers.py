"""Measures the age of the items that a slow reader gets.

Frames of 18 KB go at 30 a second into two channels, and each reader rests after each frame.

python -m tests.benchmarks.slow_readers [--seconds 24] [--rest 0.2]
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster

FRAME = bytes(18_000)
PERIOD_S = 1 / 30


def produce(channels: list[Any], until_s: float) -> None:
    """A frame into each channel in each period."""
    due_s = time.monotonic()
    while due_s < until_s:
        stamp = st.now()
        for channel in channels:
            channel.put(FRAME, time=stamp)
        due_s += PERIOD_S
        time.sleep(max(0.0, due_s - time.monotonic()))


def read(taken: Iterator[int], rest_s: float, until_s: float, ages_s: list[float]) -> None:
    """Take an item or a cut, note its age, and rest."""
    for stamp in taken:
        ages_s.append((st.now() - stamp) / 1e9)
        time.sleep(rest_s)
        if time.monotonic() > until_s:
            return


def readers(channel: Any, group: Any) -> dict[str, tuple[Any, Callable[[Any], int]]]:
    """The kinds of readers. Each kind comes with a function that returns the time of an item, cut or match that the
    reader got.
    """
    return {
        'subscribe(mode="newest")': (channel.subscribe(mode="newest"), lambda item: item.time),
        "subscribe()": (channel.subscribe(), lambda item: item.time),
        'group[c].subscribe(mode="newest")': (group[channel].subscribe(mode="newest"), lambda item: item.time),
        "group.subscribe()": (group.subscribe(), lambda cut: cut.time),
        "group.match()": (group.match(channel, "10ms"), lambda matched: matched.time),
    }


def main() -> None:
    """Print a line for each kind of reader."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=24.0)
    parser.add_argument("--rest", type=float, default=0.2, help="the pause of a reader after each item, in seconds")
    arguments = parser.parse_args()
    with LocalCluster(hosts=1, supernodes=1) as cluster:
        secret = cluster.secret_file.read_text().strip()
        with st.connect(cluster.address, secret=secret) as rt:
            left, right = (rt.channel(f"slow/{side}", max_age="3s") for side in ("left", "right"))
            made = readers(left, rt.group("slow", [left, right]))
            until_s = time.monotonic() + arguments.seconds
            ages: dict[str, list[float]] = {name: [] for name in made}
            threads = [threading.Thread(target=produce, args=([left, right], until_s))]
            for name, (stream, age_of) in made.items():
                threads.append(
                    threading.Thread(target=read, args=(map(age_of, stream), arguments.rest, until_s, ages[name]))
                )
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            print(f"{arguments.seconds:g} s, {arguments.rest:g} s of rest after each, max_age 3 s")
            print(f"{'reader':36}{'taken':>6}{'age p50 s':>11}{'max':>9}{'last':>9}  skipped  dropped")
            for name, (stream, _) in made.items():
                found = ages[name]
                counts = [getattr(stream, key, "-") for key in ("skipped", "dropped")]
                print(
                    f"{name:36}{len(found):6}{median(found):11.3f}{max(found):9.3f}{found[-1]:9.3f}"
                    f"{counts[0]:>9}{counts[1]:>9}"
                )


if __name__ == "__main__":
    main()
