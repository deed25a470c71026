"""Attacks a cluster of processes on this machine, one attack after the other, and prints the harm of each to good
clients.

The host has a budget of 64 MiB for its channels and queues, and its soft limit of open files is 1024. Two good clients
put 100 bytes and read them, every 10 ms: first alone, then during the attack by another process, and then alone
again. They have one client token, and the attacker has another. They use sockets, as clients of one machine do. Readers
of shared memory would make no calls to the host.

There are two trials of each attack. In the first trial the attacker takes only idle processor time (SCHED_IDLE),
because a hostile client runs on a machine of its own. The goal is for this trial. In the second trial the attacker has
the same priority as the host and the good clients. Then the good clients are measured also while a program runs that
takes as much processor time as this attacker, and makes no calls. Run the command on an otherwise idle machine. On a
busy machine the attacker of the first trial gets too little time. The last column shows the processor time of the
attackers in both trials.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

from stampede_rt_bench.tables import Table
from tests.benchmarks.attacks.attacked_cluster import TRANSPORT
from tests.benchmarks.attacks.catalogue import CASES
from tests.benchmarks.attacks.own_process import WorkNotFinished, in_own_process
from tests.benchmarks.attacks.trial import AttackResult, Setup, run_trial

COLUMNS = (
    "attack", "before", "RSS, MiB", "good calls, failed", "good put alone, p50 / p99, ms", "beside the attack",
    "p99 longer", "on the same cores", "without an attack, cores as busy", "attacker's CPU, %",
)  # fmt: skip
RUN_SECONDS_MAX = 180.0
"""A trial may last this time and four times the length of the attack. After that it is killed."""
NOTE = f"The good clients, and attackers with the client library, use the transport {TRANSPORT!r}."
LOG_BYTES_USUAL = 3000  # the log of a cluster that does not report the attack


@dataclass(frozen=True)
class AttackTrials:
    """Both trials of one attack."""

    apart: AttackResult
    same_cores: AttackResult


def row(measured: AttackTrials, attack: str) -> list[str]:
    """A row of the table.

    `attack`: the text of its first cell. Memory, failures and the log are the worse values of both trials.
    """
    found, same_cores = measured.apart, measured.same_cores
    trials = (found, same_cores)
    worse = max(trials, key=lambda one: one.most_mib)
    failed, lost = (sum(len(one.beside.failures) for one in trials), sum(one.leases_lost for one in trials))
    log_bytes = max(one.log_bytes for one in trials)
    remarks = [f"{lost} leases lost"] if lost else []
    remarks += [f"{log_bytes:,} bytes of log"] if log_bytes > LOG_BYTES_USUAL else []
    return [
        attack,
        CASES[found.name].before,
        ", ".join(f"{mib:,.0f}" for mib in (worse.before_mib, worse.most_mib, worse.after_mib)),
        "; ".join([f"{sum(one.beside.calls for one in trials):,}, {failed}", *remarks]),
        *(f"{one.quantile_ms(50):,.1f} / {one.quantile_ms(99):,.1f}" for one in (found.alone, found.beside)),
        f"{found.p99_ratio:.1f} x",
        f"{same_cores.p99_ratio:.1f} x",
        f"{same_cores.slowdown(same_cores.competing):.1f} x",
        " / ".join(f"{one.attacker_percent:.0f}" for one in trials),
    ]


def measure(name: str, seconds: float, runs: int) -> AttackTrials:
    """The run whose ratio is the median. Prints each run on standard error. Raises WorkNotFinished."""
    every, limit_s = [], RUN_SECONDS_MAX + 4 * seconds
    for _ in range(runs):
        apart = in_own_process(run_trial, name, seconds, Setup(apart=True), seconds=limit_s)
        measured = AttackTrials(apart, in_own_process(run_trial, name, seconds, Setup(), seconds=limit_s))
        print("  ".join(row(measured, name)), *apart.beside.failures[:1], sep="  ", file=sys.stderr, flush=True)
        every.append(measured)
    return sorted(every, key=lambda one: one.apart.p99_ratio)[len(every) // 2]


def main() -> int:
    """Measure and print. Returns 1 if an attack could not be measured; the others are in the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}; none: all")
    parser.add_argument("--seconds", type=float, default=8.0, help="the time of each attack (default: 8)")
    parser.add_argument(
        "--runs", type=int, default=1, help="runs of each attack; the table has the median (default: 1)"
    )
    parser.add_argument(
        "--markdown", action="store_true", help="print the table of docs/security.md, each row when it is measured"
    )
    options = parser.parse_args()
    if unknown := set(options.names) - set(CASES):
        parser.error(f"there is no attack {', '.join(sorted(unknown))}; the attacks are {', '.join(CASES)}")
    table, unmeasured = Table(COLUMNS, notes=["", NOTE]), []
    if options.markdown:
        print(Table(COLUMNS).markdown(), flush=True)
    names = options.names or [*CASES]
    for number, name in enumerate(names, start=1):
        print(f"{number} of {len(names)}: {name}", file=sys.stderr, flush=True)
        try:
            found = measure(name, options.seconds, options.runs)
        except WorkNotFinished as error:
            print(f"{name} was not measured: {error}", file=sys.stderr, flush=True)
            unmeasured.append(name)
            continue
        if options.markdown:  # each row as it comes, so that nothing is lost if the command is stopped
            print(Table(row(found, f"`{name}`: {CASES[name].text}")).markdown().partition("\n")[0], flush=True)
        table.rows.append(row(found, name))
    print("\n".join(table.notes) if options.markdown else table.render())
    if unmeasured:
        print(f"not measured: {', '.join(unmeasured)}", file=sys.stderr)
    return 1 if unmeasured else 0


if __name__ == "__main__":
    sys.exit(main())
