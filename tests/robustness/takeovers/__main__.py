"""Plays take-overs and moves in virtual time: `python -m tests.robustness.takeovers [--of queues] [--seeds 1000]`.

Prints each seed that fails, with the command that plays it again.
"""

from __future__ import annotations

import argparse
import logging
import sys
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

from tests.robustness.takeovers import simulate, simulate_drains, simulate_queues

SIMULATORS: dict[str, Callable[[int], Any]] = {
    "channels": simulate.run,
    "queues": simulate_queues.run,
    "drains": simulate_drains.run,
}


class PlayedSeed(NamedTuple):
    """One seed. `failure`: the traceback of a broken promise; empty if all were kept."""

    seed: int
    found: Any
    failure: str


def main() -> int:
    """Returns exit code 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.takeovers", description=__doc__)
    parser.add_argument("--of", choices=[*SIMULATORS], help="play only these; default: all")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1, help="the number of processes")
    wanted = parser.parse_args()
    chosen = [wanted.of] if wanted.of else [*SIMULATORS]
    seeds = range(wanted.first, wanted.first + wanted.seeds)
    with ProcessPoolExecutor(wanted.processes) as pool:
        failed = [_report(kind, pool.map(partial(_play, kind), seeds, chunksize=5)) for kind in chosen]
    return 1 if any(failed) else 0


def _play(kind: str, seed: int) -> PlayedSeed:
    logging.disable(logging.ERROR)
    try:
        return PlayedSeed(seed, SIMULATORS[kind](seed), "")
    except Exception:  # noqa: BLE001 - every failure is reported with its seed
        return PlayedSeed(seed, None, traceback.format_exc())


def _report(kind: str, played: Iterable[PlayedSeed]) -> int:
    """Print the failures and the sums of all figures. Returns the number of failures."""
    failures, found = 0, []
    for one in played:
        if not one.failure:
            found.append(one.found)
            continue
        failures += 1
        replay = f"python -m tests.robustness.takeovers --of {kind} --first {one.seed} --seeds 1"
        print(f"{one.failure}replay: {replay}", file=sys.stderr, flush=True)
    sums = type(found[0])(*(sum(column) for column in zip(*found, strict=True))) if found else "nothing"
    print(f"{kind}: {len(found) + failures} seeds, {failures} failed; {sums}", flush=True)
    return failures


if __name__ == "__main__":
    sys.exit(main())
