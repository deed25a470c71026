"""The entry of the command line. It is small, so that it can handle Ctrl-C while the other modules load.

Exit status: 0 done, 1 failed, 2 wrong usage, 3 nothing to return or items missing, 130 interrupted.
"""

from __future__ import annotations

import io
import os
import sys

from stampede_rt.cli.exit_statuses import INTERRUPTED
from stampede_rt.cli.interrupts import ended_immediately, run_interruptibly

# These verbs install their own signal handlers, which Python allows only on the main thread.
ON_THE_MAIN_THREAD = ("dev", "frontend", "supernode", "host", "web", "certs", "demo", "bench")


def _prepare_output() -> None:
    """Make standard output take every text, also if the caller has closed it, or if its encoding lacks a character."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  # it stays open until the end of the process
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit status."""
    words = sys.argv[1:] if argv is None else argv
    _prepare_output()

    def work() -> int:
        from stampede_rt.cli.commands import run

        return run(words)

    try:
        if words and words[0] in ON_THE_MAIN_THREAD:
            with ended_immediately():
                return work()
        return run_interruptibly(work)
    except KeyboardInterrupt:
        return INTERRUPTED
