"""The entry of the command line. It is small, so that it can handle Ctrl-C while the other modules load.

Exit status: 0 done, 1 failed, 2 wrong usage, 3 nothing to return, 130 interrupted.
"""

from __future__ import annotations

import sys

from stampede_rt.cli.exit_statuses import INTERRUPTED
from stampede_rt.cli.interrupts import ended_at_once, run_interruptibly

# These verbs install their own signal handlers, which Python allows only on the main thread.
ON_THE_MAIN_THREAD = ("dev", "frontend", "supernode", "host", "certs", "demo", "bench")


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit status."""
    words = sys.argv[1:] if argv is None else argv

    def work() -> int:
        from stampede_rt.cli.commands import run

        return run(words)

    try:
        if words and words[0] in ON_THE_MAIN_THREAD:
            with ended_at_once():
                return work()
        return run_interruptibly(work)
    except KeyboardInterrupt:
        return INTERRUPTED
