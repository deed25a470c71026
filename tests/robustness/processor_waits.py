"""Measures the time for which threads of some processes wait for a processor, by the kernel's count (proc(5),
schedstat).

A thread that waits for a lock, for input or for another thread does not wait for a processor. So a lost lease with
long waits is the machine's fault, and a lost lease without them is a fault of the program.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

PERIOD_SECONDS = 0.25
SAMPLES = 8  # in each window
STARVED_SHARE = 0.6
"""A service whose thread waits for this share of 2 s may lose a lease of 2 s. On two processors that only the services
and their callers use, a thread waits for less.
"""
LATE_EFFECT_SECONDS_MAX = 4.0  # a lease may end this long after the wait that delayed its renewals
WINDOWS_KEPT = 100_000


class Window(NamedTuple):
    """`share`: the part of the time from `began_s` until `ended_s` for which the most delayed thread waited."""

    began_s: float
    ended_s: float
    share: float


class ProcessorWaits:
    """Watches processes from a thread of its own, for the duration of a `with` block. `pids` gives the processes
    that run now.
    """

    def __init__(self, pids: Callable[[], Iterable[int]]) -> None:
        self._pids = pids
        self._samples: deque[tuple[float, dict[str, int]]] = deque(maxlen=SAMPLES + 1)
        self._windows: deque[Window] = deque(maxlen=WINDOWS_KEPT)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> ProcessorWaits:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(PERIOD_SECONDS):
            self.add_sample(time.monotonic(), waited_nanos(self._pids()))

    def add_sample(self, now_s: float, waited: dict[str, int]) -> None:
        """Note the time that each thread has waited so far, in nanoseconds."""
        self._samples.append((now_s, waited))
        began_s, before = self._samples[0]
        if len(self._samples) > SAMPLES:
            most = max((nanos - before.get(thread, nanos) for thread, nanos in waited.items()), default=0)
            self._windows.append(Window(began_s, now_s, most / 1e9 / (now_s - began_s)))

    @property
    def most_share(self) -> float:
        """The greatest share of all windows."""
        return max((one.share for one in [*self._windows]), default=0.0)

    def starved_at(self, moment_s: float, until_s: float | None = None) -> bool:
        """Whether a thread waited for too long at that moment, or from then until `until_s`, or shortly before."""
        last_s = moment_s if until_s is None else until_s
        near = (
            one
            for one in [*self._windows]
            if one.began_s <= last_s and moment_s <= one.ended_s + LATE_EFFECT_SECONDS_MAX
        )
        return any(one.share >= STARVED_SHARE for one in near)


def waited_nanos(pids: Iterable[int]) -> dict[str, int]:
    """The time that each thread of the processes has waited for a processor so far."""
    found = {}
    for pid in pids:
        for path in Path("/proc").glob(f"{pid}/task/*/schedstat"):
            with suppress(OSError):  # the thread has just ended
                found[str(path)] = int(path.read_text().split()[1])
    return found
