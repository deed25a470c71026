"""`python -m tests.robustness.fuzz.parsers [TARGET...] [--inputs N] [--seconds S] [--guided]`.

Without --guided each target gets random inputs, in this process. With --guided each target runs in a process of its
own, from the corpus in `out/fuzz/TARGET`, which grows. If a target fails, the program prints the input, and ends with
exit code 1.
"""

from __future__ import annotations

import argparse
import sys

from tests.robustness.fuzz.parsers.catalogue import BY_NAME
from tests.robustness.fuzz.parsers.guided import run_guided
from tests.robustness.fuzz.parsers.unguided import run_unguided


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", help="default: all targets")
    parser.add_argument("--inputs", type=int, default=100_000, help="the inputs for each target")
    parser.add_argument("--seconds", type=int, default=600, help="the most seconds for each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--guided", action="store_true")
    arguments = parser.parse_args()
    names = arguments.targets or sorted(BY_NAME)
    if unknown := set(names) - set(BY_NAME):
        parser.error(f"there is no target {', '.join(sorted(unknown))}; the targets are {', '.join(sorted(BY_NAME))}")
    run = run_guided if arguments.guided else run_unguided
    found = [
        name for name in names if not run(name, inputs=arguments.inputs, seconds=arguments.seconds, seed=arguments.seed)
    ]
    print(f"{len(names)} targets, {len(found)} with findings: {' '.join(found)}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
