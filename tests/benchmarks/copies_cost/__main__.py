"""The costs of copies and moves, each compared with the same work without them. The two cases alternate.

    python -m tests.benchmarks.copies_cost --only ack|proxy|feed|drain [--rounds 5]

Each part takes at most three minutes and prints a Markdown table: medians of the rounds, with the least and the
greatest value, and the goal. All processes are on this machine. Clients use gRPC, except where a row
names sockets.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

from stampede_rt_bench.tables import Table
from tests.benchmarks.copies_cost import ack, drain, feed, proxy

PARTS: dict[str, Callable[[int], Table]] = {
    "ack": ack.measure,
    "proxy": proxy.measure,
    "feed": feed.measure,
    "drain": drain.measure,
}


def main() -> None:
    """Measure all parts, or one of them, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=PARTS, help="measure only this part")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    for name in [arguments.only] if arguments.only else PARTS:
        load = os.getloadavg()[0]
        table = PARTS[name](arguments.rounds)
        table.notes.append(f"{arguments.rounds} rounds; {os.cpu_count()} cores, load {load:.1f} before the run.")
        print(f"\n### {name}\n\n{table.markdown()}", flush=True)


if __name__ == "__main__":
    main()
