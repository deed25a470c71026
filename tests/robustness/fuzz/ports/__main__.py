"""`python -m tests.robustness.fuzz.ports [PORT...] [--inputs N] [--seed N]`: exit code 1 if it found something."""

from __future__ import annotations

import argparse
import asyncio
import sys

from tests.robustness.fuzz.ports.methods import PORTS
from tests.robustness.fuzz.ports.run import run


def main() -> int:
    parser = argparse.ArgumentParser(description="call all RPCs with messages that no client of the product sends")
    parser.add_argument("ports", nargs="*", help=f"some of {', '.join(PORTS)}; default: all")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="requests for each port")
    parser.add_argument("--seconds", type=float, default=36_000.0, help="the most seconds for each port")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tls", action="store_true", help="with certificates of all roles instead of the secret")
    arguments = parser.parse_args()
    found = 0
    for port in arguments.ports or PORTS:
        wanted = {"seed": arguments.seed, "inputs": arguments.inputs, "seconds": arguments.seconds}
        outcome = asyncio.run(run(port, **wanted, tls=arguments.tls, report=_report))
        print(outcome, flush=True)
        found += len(outcome.findings)
    return 1 if found else 0


def _report(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
