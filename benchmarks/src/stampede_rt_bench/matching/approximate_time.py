"""Replays a recording into the C++ ApproximateTime policy of ROS message_filters, which this module builds.

Debian's package libmessage-filters-dev has this policy. The built program needs no ROS installation, and sends nothing.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from stampede_rt_bench.matching.message_filters import QUEUE_ITEMS, RUN_SECONDS_MAX
from stampede_rt_bench.matching.recording import RATES_HZ, REFERENCE, Arrival
from stampede_rt_bench.matching.sets import FoundSet, Replay

PACKAGE = "libmessage-filters-dev"
COMPILER = "g++"
HEADER = Path("/usr/include/message_filters/sync_policies/approximate_time.h")
SOURCE = Path(__file__).with_name("approximate_time.cpp")
LIBRARIES = ("message_filters", "roscpp", "rosconsole", "rostime", "boost_thread", "boost_system", "pthread")


def is_installed() -> bool:
    """Whether the headers and a compiler are installed."""
    return HEADER.exists() and shutil.which(COMPILER) is not None


@cache
def _program() -> Path:
    """Build the program at the first call, and return its path. Python removes its folder when the interpreter ends.

    The program is not optimised: the recording has times of its own, and the program's speed changes no figure.
    """
    folder = tempfile.TemporaryDirectory(prefix="stampede-bench-")
    _folders.append(folder)
    program = Path(folder.name) / "approximate_time"
    flags = ["-w", "-o", str(program), str(SOURCE), *(f"-l{library}" for library in LIBRARIES)]
    subprocess.run([COMPILER, *flags], capture_output=True, timeout=RUN_SECONDS_MAX, check=True)
    return program


_folders: list[tempfile.TemporaryDirectory[str]] = []


def replay(arrivals: Sequence[Arrival], tolerance_nanos: int) -> Replay:
    """Return the sets that the policy gives to its callback for this recording, with their times.

    `tolerance_nanos` becomes the policy's greatest interval.
    """
    streams = list(RATES_HZ)
    lines = [f"{tolerance_nanos} {QUEUE_ITEMS}"]
    lines += [f"{arrival.arrived} {streams.index(arrival.stream)} {arrival.time}" for arrival in arrivals]
    ran = subprocess.run(
        [_program()], input="\n".join(lines), capture_output=True, text=True, timeout=RUN_SECONDS_MAX, check=True
    )
    sets = []
    for line in ran.stdout.splitlines():
        given, *times = map(int, line.split())
        by_stream = dict(zip(streams, times, strict=True))
        sets.append(FoundSet(given=given, reference=by_stream.pop(REFERENCE), times=by_stream))
    return Replay(sets=sets, reported_unmatched=None)
