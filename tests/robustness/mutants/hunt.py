"""Runs a simulator until a seed fails: `python -m tests.robustness.mutants.hunt log 100`.

Exit code 0 and one line if a promise was broken, 1 if none was. Any other exception ends the program, because it is no
finding.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

from stampede_rt_supernode.replication.rules.raft_node import InvariantViolation
from tests.robustness.directory import simulate as directory
from tests.robustness.directory import upgrading
from tests.robustness.histories.linearizability import NotLinearizable
from tests.robustness.replication import simulate as log
from tests.robustness.takeovers import simulate as takeovers
from tests.robustness.takeovers import simulate_drains as drains
from tests.robustness.takeovers import simulate_queues as queues

SIMULATORS: dict[str, Callable[[int], object]] = {
    "log": log.run,
    "directory": directory.run,
    "upgrading": upgrading.run,
    "takeovers": takeovers.run,
    "queues": queues.run,
    "drains": drains.run,
}
# The errors of the checks, and the errors of the product that notices a fault itself and stops.
BROKEN_PROMISES = (AssertionError, NotLinearizable, InvariantViolation)


def main() -> int:
    """Run seeds from 0 on."""
    simulator, seeds = sys.argv[1:]
    logging.disable(logging.WARNING)  # services warn of the injected faults
    for seed in range(int(seeds)):
        try:
            SIMULATORS[simulator](seed)
        except BROKEN_PROMISES as broken:
            print(f"{seed + 1} {broken}")
            return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
