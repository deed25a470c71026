"""A service as users start it, with two changes for tests: `python -m tests.support.service_process PACKAGE FLAGS`.

A test can step its wall clock, and the log of a supernode is compacted early.

The kernel has no namespace for CLOCK_REALTIME (time_namespaces(7): monotonic and boottime only). So the step is added
to `time.time_ns`, from which services take all their wall-clock times. The clock of leases (CLOCK_BOOTTIME) is not
affected, as when an operator sets the date. `time.time` stays as it is: gRPC computes deadlines from
`time.time`, and its C code compares them with the kernel's clock. So a step of `time.time` would break the deadlines. A
library that is loaded before the C library (libfaketime 0.9.10) also steps gRPC's clock. But it has other effects:
`time.sleep` fails, and timed waits on the monotonic clock take too long or too short.
"""

from __future__ import annotations

import importlib
import os
import sys
import time
from pathlib import Path

CLOCK_FILE, SNAPSHOT_EVERY = "ROBUSTNESS_CLOCK_FILE", "ROBUSTNESS_SNAPSHOT_EVERY"


def shift_wall_clock(file: Path) -> None:
    """Read the offset of the wall clock from `file`, a decimal number of nanoseconds, from now on."""
    descriptor = os.open(file, os.O_RDONLY)
    true_time_ns = time.time_ns

    def time_ns() -> int:
        return true_time_ns() + int(os.pread(descriptor, 32, 0) or b"0")

    time.time_ns = time_ns


def compact_early(entries: int) -> None:
    """Take snapshots after few entries, so that the log is compacted even during a short partition."""
    from stampede_rt_supernode.replication.settings import ReplicationSettings

    defaults = ReplicationSettings.__init__.__kwdefaults__
    assert defaults is not None
    assert "snapshot_every_entries" in defaults, "the setting has another name now"
    defaults["snapshot_every_entries"] = entries


def main() -> int:
    """Run the service; returns its exit code."""
    package, *words = sys.argv[1:]
    if file := os.environ.get(CLOCK_FILE):
        shift_wall_clock(Path(file))
    if entries := os.environ.get(SNAPSHOT_EVERY):
        compact_early(int(entries))
    return int(importlib.import_module(f"{package}.app").main(words))


if __name__ == "__main__":
    sys.exit(main())
