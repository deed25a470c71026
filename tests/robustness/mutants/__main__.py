"""`python -m tests.robustness.mutants [NAME ...]`: plants each fault, and prints which test noticed it, and how soon.

It plants two faults at the same time. A test or simulator stops at the first finding, and has a time limit.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ThreadPoolExecutor

from tests.robustness.mutants.planted import MUTANTS
from tests.robustness.mutants.planting import NO_VERDICT, Verdict, judge, run_detector

PARALLEL_PROCESSES = 2


def main() -> int:
    """Returns exit code 1 if a fault goes unnoticed, or if a test fails without a fault."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="plant only these faults; default: all")
    names = parser.parse_args().names
    if unknown := set(names) - {one.name for one in MUTANTS}:
        parser.error(f"no such mutants: {', '.join(sorted(unknown))}")
    chosen = [one for one in MUTANTS if one.name in names or not names]
    print("| mutant | must be noticed by | noticed | seconds |\n| --- | --- | --- | --- |")
    with ThreadPoolExecutor(PARALLEL_PROCESSES) as pool:
        verdicts = [_shown(one) for one in pool.map(judge, chosen)]
        detectors = sorted({one.noticed_by for one in chosen})
        quiet = [_shown_without(*one) for one in pool.map(_run_without, detectors)]
    unnoticed = [one.mutant.name for one in verdicts if not one.noticed]
    if unnoticed:
        print(f"unnoticed: {', '.join(unnoticed)}", file=sys.stderr)
    return 0 if not unnoticed and all(quiet) else 1


def _shown(verdict: Verdict) -> Verdict:
    mutant, seen = verdict.mutant, verdict.how if verdict.noticed else f"**no**: {verdict.how}"
    print(f"| {mutant.name} | {mutant.noticed_by.split('::')[-1]} | {seen} | {verdict.seconds:.0f} |", flush=True)
    return verdict


def _run_without(detector: str) -> tuple[str, bool, str, float]:
    """Run a test or simulator without a fault. It must pass, or its findings would prove nothing."""
    began = time.monotonic()
    noticed, how = run_detector(detector, package_path=None)
    return detector, noticed or how.startswith(NO_VERDICT), how, time.monotonic() - began


def _shown_without(detector: str, is_wrong: bool, how: str, seconds: float) -> bool:
    wrongly = "**wrongly**: " if is_wrong else ""
    print(f"| (none) | {detector.split('::')[-1]} | {wrongly}{how} | {seconds:.0f} |", flush=True)
    return not is_wrong


if __name__ == "__main__":
    sys.exit(main())
