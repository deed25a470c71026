"""Attack a cluster of processes on this machine, one attack after the other; print what each took from good clients.

The host has a budget of 64 MiB for what it keeps, and its soft limit of open files is 1024. Two good clients put 100
bytes and read them, each 10 ms: alone, then beside the attacker, which is a process of its own, then alone again. They
have one client token, and the attacker has another.
"""

from __future__ import annotations

import argparse
import sys

from stampede_rt_bench.tables import Table
from tests.benchmarks.attacks.catalogue import CASES
from tests.benchmarks.attacks.own_process import Unfinished, in_own_process
from tests.benchmarks.attacks.trial import Found, run_trial

COLUMNS = (
    "attack", "before", "RSS, MiB", "good calls, failed", "good put alone, p50 / p99, ms", "beside the attack",
    "p99 longer",
)  # fmt: skip
RUN_SECONDS_MAX = 180.0
"""The longest time of one run beside four times the length of the attack. Then it is killed."""
LOG_BYTES_USUAL = 2000  # of a cluster under attack that says nothing of it


def row(found: Found, attack: str) -> list[str]:
    """Of the table. `attack`: the text of its first cell."""
    memory = (found.before_mib, found.most_mib, found.after_mib)
    remarks = [f"{found.leases_lost} leases lost"] if found.leases_lost else []
    remarks += [f"{found.log_bytes:,} bytes of log"] if found.log_bytes > LOG_BYTES_USUAL else []
    return [
        attack,
        CASES[found.name].before,
        ", ".join(f"{mib:,.0f}" for mib in memory),
        "; ".join([f"{found.beside.calls:,}, {len(found.beside.failures)}", *remarks]),
        *(f"{one.quantile_ms(50):,.1f} / {one.quantile_ms(99):,.1f}" for one in (found.alone, found.beside)),
        f"{found.p99_ratio:.1f} x",
    ]


def measure(name: str, seconds: float, runs: int) -> Found:
    """The run whose ratio is the median. Tells of each run on standard error. Raises Unfinished."""
    every = []
    for _ in range(runs):
        found = in_own_process(run_trial, name, seconds, seconds=RUN_SECONDS_MAX + 4 * seconds)
        print("  ".join(row(found, name)), *found.beside.failures[:1], sep="  ", file=sys.stderr, flush=True)
        every.append(found)
    return sorted(every, key=lambda found: found.p99_ratio)[len(every) // 2]


def main() -> int:
    """Measure and print. Returns 1 if an attack could not be measured; the others are in the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}; none: all")
    parser.add_argument("--seconds", type=float, default=8.0, help="how long each attack lasts (default: 8)")
    parser.add_argument(
        "--runs", type=int, default=1, help="runs of each attack; the table has the median (default: 1)"
    )
    parser.add_argument("--markdown", action="store_true", help="print the table of docs/security.md")
    options = parser.parse_args()
    if unknown := set(options.names) - set(CASES):
        parser.error(f"there is no attack {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    table, unmeasured = Table(COLUMNS), []
    names = options.names or [*CASES]
    for number, name in enumerate(names, start=1):
        print(f"{number} of {len(names)}: {name}", file=sys.stderr, flush=True)
        try:
            found = measure(name, options.seconds, options.runs)
        except Unfinished as error:
            print(f"{name} was not measured: {error}", file=sys.stderr, flush=True)
            unmeasured.append(name)
            continue
        table.rows.append(row(found, f"`{name}`: {CASES[name].text}" if options.markdown else name))
    print(table.markdown() if options.markdown else table.render())
    if unmeasured:
        print(f"not measured: {', '.join(unmeasured)}", file=sys.stderr)
    return 1 if unmeasured else 0


if __name__ == "__main__":
    sys.exit(main())
