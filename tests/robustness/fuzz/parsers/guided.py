"""Runs each target under atheris in a process of its own, `guided_process`. libFuzzer ends it at the first finding."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from tests.robustness.fuzz.parsers.catalogue import MODULE_OF

CORPUS = Path("out/fuzz")
INPUT_SECONDS_MAX = 20
START_SECONDS_MAX = 120  # on a busy machine; about two seconds of processor time
MEMORY_MIB_MAX = 2048
INPUT_BYTES_MAX = 1200
PROCESS = "tests.robustness.fuzz.parsers.guided_process"
_COVERED = re.compile(r"^#\d+\s.*cov: (\d+)", re.MULTILINE)
_STATISTIC = re.compile(r"^stat::(\w+):\s+(\d+)$", re.MULTILINE)


class GuidedRun(NamedTuple):
    """The report of libFuzzer about a run.

    `covered_first`, `covered`: the branches that the first inputs, and all inputs, have reached.
    """

    inputs: int
    per_second: int
    covered_first: int
    covered: int

    @classmethod
    def of(cls, output: str) -> GuidedRun:
        """The run with this output. Counts that are missing are 0."""
        covered = [int(one) for one in _COVERED.findall(output)] or [0]
        statistics = {name: int(number) for name, number in _STATISTIC.findall(output)}
        inputs, speed = statistics.get("number_of_executed_units", 0), statistics.get("average_exec_per_sec", 0)
        return cls(inputs, speed, covered[0], covered[-1])

    @property
    def is_guided(self) -> bool:
        """Whether the code of the target is instrumented. A small parser may have few branches."""
        return self.covered > 0


def run_guided(name: str, *, inputs: int, seconds: int, seed: int) -> bool:
    """Returns whether nothing was found. Prints a line, and after a finding all output of libFuzzer.

    Raises ImportError without atheris.
    """
    import atheris  # noqa: F401 - raises ImportError before a process is started

    corpus = CORPUS / name
    corpus.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", PROCESS, MODULE_OF[name], name, *_options(name, corpus, inputs, seconds, seed)]
    limit_s = seconds + INPUT_SECONDS_MAX + START_SECONDS_MAX
    try:
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, errors="replace", timeout=limit_s
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        print(f"FOUND by {name}: it has not ended after {limit_s} s", flush=True)
        return False
    run = GuidedRun.of(done.stderr)
    grows = f"{run.covered_first:,} to {run.covered:,} branches"
    print(f"{name}: {run.inputs:,} inputs, {run.per_second:,}/s, {grows}", flush=True)
    if done.returncode or not run.is_guided:
        print("\n".join(one for one in done.stderr.splitlines() if not one.startswith("INFO: Instrumenting")))
        print(f"FOUND by {name}: exit code {done.returncode}, {run.covered} branches")
    return not done.returncode and run.is_guided


def _options(name: str, corpus: Path, inputs: int, seconds: int, seed: int) -> list[str]:
    words = [str(corpus), f"-runs={inputs}", f"-max_total_time={seconds}", f"-seed={seed}", "-print_final_stats=1"]
    bounds = [f"-timeout={INPUT_SECONDS_MAX}", f"-rss_limit_mb={MEMORY_MIB_MAX}", f"-max_len={INPUT_BYTES_MAX}"]
    return [*words, *bounds, f"-artifact_prefix={CORPUS}/found-{name}-"]
