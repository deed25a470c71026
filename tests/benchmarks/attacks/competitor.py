"""A program that has nothing to do with the cluster, and takes as much processor time as an attacker took.

It reads a JSON list from its standard input: the seconds of processor time that the attacker took in each slot of
SLOT_SECONDS. It takes the same time in each slot, and repeats the list until its standard input is closed. It prints a
line when it begins.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import threading
import time
from itertools import cycle

from tests.benchmarks.attacks.attacker import UNDER_WAY

SLOT_SECONDS = 0.05


def take(slots: list[float]) -> None:
    """Take the stated seconds of processor time in each slot, and begin again after the last slot. Never returns."""
    begins_s = time.monotonic()
    for busy_s in cycle(slots):
        until_s = time.thread_time() + busy_s
        while time.thread_time() < until_s and time.monotonic() < begins_s + SLOT_SECONDS:
            pass
        begins_s += SLOT_SECONDS
        time.sleep(max(0.0, begins_s - time.monotonic()))


def main() -> None:
    """Run one process for each processor that the attacker kept busy."""
    slots: list[float] = json.loads(sys.stdin.readline())
    count = max(1, -(-int(1000 * max(slots)) // int(1000 * SLOT_SECONDS)))
    share = [busy_s / count for busy_s in slots]
    for _ in range(count):
        multiprocessing.Process(target=take, args=(share,), daemon=True).start()
    print(UNDER_WAY, flush=True)
    threading.Thread(target=sys.stdin.read).start()  # at the end of the input this process ends its children


if __name__ == "__main__":
    main()
