"""The entry of the command line: small, so that an interrupt finds it ready while all the rest is still loaded.

Exit status: 0 done, 1 failed, 2 used wrongly, 3 nothing there to return, 130 interrupted.
"""

from __future__ import annotations

import sys

INTERRUPTED = 130


def main(argv: list[str] | None = None) -> int:
    """Run one command; the exit status is returned."""
    try:
        from stampede_rt.cli.commands import run

        return run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        return INTERRUPTED
