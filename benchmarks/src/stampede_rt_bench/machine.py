"""Describes the machine of the measurement."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median

KIB = 1024
LOOP_TURNS = 20_000  # about a millisecond
LOOPS_SECONDS, PAUSE_SECONDS = 3.0, 0.002


def describe(packages: Sequence[str]) -> dict[str, str]:
    """Return facts about the machine, and the versions of installed packages, by name."""
    memory_kib = int(_first(r"^MemTotal:\s*(\d+)", Path("/proc/meminfo")) or 0)
    described = {
        "processor": _first(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo")) or platform.machine(),
        "cores": str(os.cpu_count()),
        "memory": f"{memory_kib / KIB / KIB:.0f} GiB",
        "kernel": f"{platform.system()} {platform.release()}",
        "Python": platform.python_version(),
        "load before": f"{os.getloadavg()[0]:.1f}",
        "steadiness": steadiness(_loop_times()),
    }
    return described | {package: _version_of(package) for package in packages}


def steadiness(loop_times: Sequence[float]) -> str:
    """Say how many of these CPU times of equal loops are longer than twice their median, and how long the longest is.

    Neighbours of a virtual machine, or a limit of its processors, make some of them long. A percentile of latencies
    beyond this share shows the machine, and not only the measured system.
    """
    usual = median(loop_times)
    slow_percent = 100 * sum(one > 2 * usual for one in loop_times) / len(loop_times)
    longest = max(loop_times) / usual
    return f"{slow_percent:.1f} % of bare loops over twice their median CPU time, the longest {longest:.1f} x"


def _loop_times() -> list[float]:
    """Return the CPU times of a bare loop in LOOPS_SECONDS, in seconds."""
    taken: list[float] = []
    end_s = time.monotonic() + LOOPS_SECONDS
    while time.monotonic() < end_s:
        began_s = time.thread_time()
        for _ in range(LOOP_TURNS):
            pass
        taken.append(time.thread_time() - began_s)
        time.sleep(PAUSE_SECONDS)
    return taken


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _first(pattern: str, file: Path) -> str:
    try:
        found = re.search(pattern, file.read_text(), re.MULTILINE)
    except OSError:
        return ""
    return found[1].strip() if found else ""
