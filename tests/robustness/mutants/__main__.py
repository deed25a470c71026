"""`python -m tests.robustness.mutants [NAME ...]`: plants each fault and shows who noticed it, and how soon."""

from __future__ import annotations

import argparse
import sys

from tests.robustness.mutants.planted import MUTANTS
from tests.robustness.mutants.planting import Verdict, ask, judge


def main() -> int:
    """Exit code 1 if a fault goes unnoticed, or if code without a fault is found fault with."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="these only")
    names = parser.parse_args().names
    if unknown := set(names) - {one.name for one in MUTANTS}:
        parser.error(f"no such mutants: {', '.join(sorted(unknown))}")
    chosen = [one for one in MUTANTS if one.name in names or not names]
    print("| mutant | must be noticed by | noticed | seconds |\n| --- | --- | --- | --- |")
    verdicts = [_shown(judge(one)) for one in chosen]
    unnoticed = [one.mutant.name for one in verdicts if not one.noticed]
    if unnoticed:
        print(f"unnoticed: {', '.join(unnoticed)}", file=sys.stderr)
    return 1 if unnoticed or not _quiet_without({one.noticed_by for one in chosen}) else 0


def _shown(verdict: Verdict) -> Verdict:
    mutant, seen = verdict.mutant, verdict.how if verdict.noticed else f"**no**: {verdict.how}"
    print(f"| {mutant.name} | {mutant.noticed_by.split('::')[-1]} | {seen} | {verdict.seconds:.0f} |", flush=True)
    return verdict


def _quiet_without(detectors: set[str]) -> bool:
    """Whether whoever noticed a fault says nothing of the code as it is."""
    loud = False
    for who in sorted(detectors):
        noticed, how = ask(who, package_path=None)
        loud |= noticed or how.startswith("could not be asked")
        print(f"| (none) | {who.split('::')[-1]} | {'**wrongly**: ' if noticed else ''}{how} | |", flush=True)
    return not loud


if __name__ == "__main__":
    sys.exit(main())
