"""A short run of the parsers' part of `make fuzz`."""

from __future__ import annotations

import importlib.util
import itertools
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.robustness.fuzz.parsers import unguided
from tests.robustness.fuzz.parsers.catalogue import BY_NAME, MODULE_OF
from tests.robustness.fuzz.parsers.guided import GuidedRun, run_guided
from tests.robustness.fuzz.parsers.unguided import run_unguided

INPUTS, SECONDS = 1000, 20.0


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_a_parser_accepts_or_refuses_any_input(name: str) -> None:
    assert run_unguided(name, inputs=INPUTS, seconds=SECONDS, seed=11)


@pytest.mark.parametrize(("clock", "is_fine"), [("monotonic", True), ("process_time", False)])
def test_an_input_is_slow_by_its_processor_time_and_not_because_the_machine_is_busy(
    monkeypatch: pytest.MonkeyPatch, clock: str, is_fine: bool
) -> None:
    jumps = itertools.count(0.0, 2 * unguided.INPUT_SECONDS_MAX)
    clocks = {"monotonic": lambda: 0.0, "process_time": lambda: 0.0, clock: lambda: next(jumps)}
    monkeypatch.setattr(unguided, "time", SimpleNamespace(**clocks))
    assert run_unguided("glob", inputs=3, seconds=3600, seed=11) is is_fine


@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not there: uv sync --group fuzz")
def test_coverage_guides_a_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.robustness.fuzz.parsers.guided.CORPUS", tmp_path)
    assert run_guided("item_run", inputs=500, seconds=20, seed=1)
    assert len([*(tmp_path / "item_run").iterdir()]) > 1, "inputs that reach new code are kept"


def test_the_report_of_libfuzzer_is_understood() -> None:
    output = """INFO: -max_len is not provided
#2\tINITED cov: 17 ft: 17 corp: 1/1b exec/s: 0 rss: 70Mb
#9\tNEW    cov: 31 ft: 33 corp: 2/3b lim: 4 exec/s: 0 rss: 70Mb L: 2/2 MS: 1 ChangeBit-
#500\tDONE   cov: 108 ft: 140 corp: 20/88b lim: 8 exec/s: 250 rss: 71Mb
stat::number_of_executed_units: 500
stat::average_exec_per_sec:     250
"""
    run = GuidedRun.of(output)
    assert run == GuidedRun(inputs=500, per_second=250, covered_first=17, covered=108)
    assert run.is_guided
    assert not GuidedRun.of("a process that ended immediately").is_guided


def test_each_target_names_the_module_that_the_guided_process_imports() -> None:
    for name, module in MODULE_OF.items():
        assert BY_NAME[name] in import_module(module).TARGETS
