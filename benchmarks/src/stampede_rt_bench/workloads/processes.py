"""Measures the CPU time of processes, and runs servers that end with the benchmark."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

READY_SECONDS = 20.0
STOP_SECONDS = 5.0
_TICKS_PER_SECOND = os.sysconf("SC_CLK_TCK")


class ServerFailed(Exception):
    """A server could not start; the text has its output."""


def cpu_seconds(pids: Iterable[int]) -> float:
    """Return the user and system time of all these processes, in steps of 10 ms. Ended processes count as 0."""
    ticks = 0
    for pid in pids:
        with suppress(OSError):
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            ticks += int(words[11]) + int(words[12])
    return ticks / _TICKS_PER_SECOND


@contextmanager
def server(command: Sequence[str], log: Path, is_ready: Callable[[], bool]) -> Iterator[int]:
    """Run a program until the end of the context. Yields its process id when it is ready.

    The kernel ends the program if this process dies. Raises ServerFailed.
    """
    guard = ["setpriv", "--pdeathsig", "KILL"] if shutil.which("setpriv") else []
    with log.open("wb") as output:
        process = subprocess.Popen([*guard, *command], stdin=subprocess.DEVNULL, stdout=output, stderr=output)
    try:
        until_s = time.monotonic() + READY_SECONDS
        while not is_ready():
            if process.poll() is not None or time.monotonic() > until_s:
                raise ServerFailed(f"{command[0]} is not ready: {log.read_text(errors='replace')[-2000:]}")
            time.sleep(0.01)
        yield process.pid
    finally:
        process.terminate()
        try:
            process.wait(STOP_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
