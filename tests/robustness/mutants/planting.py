"""Plants one fault in a copy of its package, and runs the test or simulator that must notice it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.robustness.mutants.hunt import SIMULATORS
from tests.robustness.mutants.planted import SEEDS_MAX, Mutant

ROOT = Path(__file__).parents[3]
SECONDS_MAX = 600.0
NO_VERDICT = "no verdict"
TESTS_FAILED = 1  # pytest's exit code


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Whether the test or simulator of a mutant noticed its fault."""

    mutant: Mutant
    noticed: bool
    # The number of seeds and the message of the failure; or why the fault was not noticed.
    how: str
    seconds: float


def judge(mutant: Mutant) -> Verdict:
    """Plant the fault, and run its test or simulator. Takes seconds or minutes. Raises LookupError if the code has
    changed, so that the fault does not fit.
    """
    source = ROOT / mutant.file.split("/src/")[0] / "src"
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        copy = Path(folder) / "src"
        shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
        place = copy / (ROOT / mutant.file).relative_to(source)
        place.write_text(mutant.plant(place.read_text()))
        noticed, how = run_detector(mutant.noticed_by, package_path=copy)
    return Verdict(mutant=mutant, noticed=noticed, how=how, seconds=time.monotonic() - began)


def run_detector(detector: str, *, package_path: Path | None, seeds: int = SEEDS_MAX) -> tuple[bool, str]:
    """Run a simulator or test. Returns whether it failed, and its message.

    `package_path`: the folder of the changed package; None: the code as it is.
    """
    simulated = detector in SIMULATORS
    hunt = ["-m", "tests.robustness.mutants.hunt", detector, str(seeds)]
    test = ["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--no-header", *detector.split()]
    path = {"PYTHONPATH": str(package_path)} if package_path else {}
    try:
        done = subprocess.run(
            [sys.executable, *(hunt if simulated else test)],
            cwd=ROOT,
            env={**os.environ, **path, "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            timeout=SECONDS_MAX,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"{NO_VERDICT}: the run took more than {SECONDS_MAX:.0f} s"
    lines = (done.stdout.strip() or done.stderr.strip()).splitlines()
    last = lines[-1] if lines else ""
    if simulated and done.returncode == 0:
        found, _, why = last.partition(" ")
        return True, f"seed {int(found) - 1}, after {found} of {seeds} seeds: {why}"
    if not simulated and done.returncode == TESTS_FAILED:
        return True, next((line.split("::")[-1] for line in lines if line.startswith("FAILED")), last)
    if done.returncode not in (0, 1) or "Traceback" in done.stderr:
        return False, f"{NO_VERDICT}: exit code {done.returncode}: {(done.stderr.strip().splitlines() or [last])[-1]}"
    return False, f"{seeds} seeds found nothing" if simulated else "the test passes"
