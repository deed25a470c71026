"""Attack a cluster of processes on this machine, one attack after the other; print what each took from good clients.

The host has a budget of 64 MiB for what it keeps, and its soft limit of open files is 1024. Two good clients put 100
bytes and read them, each 10 ms, first alone and then beside the attacker, which is a process of its own. They have one
client token, and the attacker has another.
"""

from __future__ import annotations

import argparse
import asyncio
import sys

from stampede_rt_bench.tables import Table
from tests.benchmarks.attacks.catalogue import CASES
from tests.benchmarks.attacks.trial import Found, trial

COLUMNS = (
    "attack", "RSS MiB before", "most", "after", "good calls", "failed", "put alone p50 ms", "p99", "beside p50", "p99",
    "of alone", "leases lost", "log bytes",
)  # fmt: skip


def row(found: Found) -> list[str]:
    """Of the table."""
    memory = (found.before_mib, found.most_mib, found.after_mib)
    times = (one.quantile_ms(percent) for one in (found.alone, found.beside) for percent in (50, 99))
    counts = (found.beside.calls, len(found.beside.failures))
    return [
        found.name,
        *(f"{mib:,.0f}" for mib in memory),
        *(f"{count:,}" for count in counts),
        *(f"{ms:,.1f}" for ms in times),
        f"{found.beside.quantile_ms(99) / max(0.1, found.alone.quantile_ms(99)):.1f} x",
        f"{found.leases_lost}",
        f"{found.log_bytes:,}",
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}; none: all")
    parser.add_argument("--seconds", type=float, default=8.0, help="how long each attack lasts (default: 8)")
    options = parser.parse_args()
    if unknown := set(options.names) - set(CASES):
        parser.error(f"there is no attack {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    names = options.names or [*CASES]
    table = Table(COLUMNS)
    for name in names:
        found = asyncio.run(trial(name, options.seconds))
        table.rows.append(row(found))
        print(" ".join(row(found)), *found.beside.failures[:1], sep="  ", file=sys.stderr, flush=True)
    table.print()
    for name in names:
        print(f"{name}: {CASES[name].text}.")


if __name__ == "__main__":
    main()
