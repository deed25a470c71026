"""Opens and closes things many times: `python -m tests.robustness.cycles`, or `make cycles`.

Prints a Markdown table: by how much each process has grown. Exits with 1 if a process has grown more than it may.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.robustness.cycles.cycling import KINDS
from tests.robustness.cycles.running import HEADER, counted_cluster, run

WARM_UP = 500
LONGER_WARM_UPS = {"make channel and queue": 5000}  # caches of about 20 MiB fill first


def main() -> int:
    """Run the cycles of all kinds, or of the kinds that the caller names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=10_000, help="cycles of each kind; default 10,000")
    longer = f"for some kinds up to {max(LONGER_WARM_UPS.values()):,}"
    parser.add_argument("--warm-up", type=int, help=f"cycles before the first count; default {WARM_UP}, {longer}")
    parser.add_argument(
        "--only", action="append", choices=list(KINDS), help="run only this kind of cycle; may be given several times"
    )
    arguments = parser.parse_args()
    complaints: list[str] = []
    print(HEADER, flush=True)
    with tempfile.TemporaryDirectory() as folder, counted_cluster(Path(folder)) as cluster:
        for kind in arguments.only or KINDS:
            warm_up = arguments.warm_up or LONGER_WARM_UPS.get(kind, WARM_UP)
            report = run(cluster, Path(folder), kind, warm_up, arguments.cycles)
            print(*report.rows(), sep="\n", flush=True)
            complaints += report.complaints
    print(*complaints or ["no process has grown"], sep="\n")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
