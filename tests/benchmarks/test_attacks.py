"""The table in docs/security.md has all attacks. The command that prints the table ends, whatever an attack does."""

from __future__ import annotations

import math
import os
import re
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.attacks import __main__ as command
from tests.benchmarks.attacks.catalogue import CASES
from tests.benchmarks.attacks.own_process import WorkNotFinished, in_own_process
from tests.benchmarks.attacks.trial import AttackResult, GoodCalls

DOCS = Path(__file__).parents[2] / "docs"


def test_each_attack_has_a_row_in_the_table_of_the_docs() -> None:
    rows = re.findall(r"^\| `([a-z-]+)`: ", (DOCS / "security.md").read_text(), re.MULTILINE)
    assert sorted(rows) == sorted(CASES)


def test_puts_without_an_answer_raise_the_quantiles() -> None:
    assert GoodCalls().quantile_ms(99) == math.inf
    good = GoodCalls([1.0] * 10)
    good.note(0.5)
    good.note(9000.0)
    assert good.puts_ms == [1.0] * 10 + [9000.0]


def one_that_hangs() -> None:
    signal.pause()


def one_that_fails() -> None:
    raise ValueError("no such cluster")


def one_whose_process_ends() -> None:
    os._exit(7)


@pytest.mark.parametrize(
    ("work", "why"),
    [
        (one_that_hangs, "was killed after 0 s"),
        (one_that_fails, "no such cluster"),
        (one_whose_process_ends, "status 7"),
    ],
)
def test_work_that_hangs_or_fails_is_reported(work: Any, why: str) -> None:
    with pytest.raises(WorkNotFinished, match=why):
        in_own_process(work, seconds=0.1 if work is one_that_hangs else 30.0)


def test_attacks_that_were_not_measured_are_named_and_the_others_are_in_the_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(work: Any, name: str, *_: Any, seconds: float) -> AttackResult:
        if name == "resets":
            raise WorkNotFinished("it was killed after 192 s")
        return AttackResult(name, GoodCalls([1.0]), GoodCalls([2.0, 3.0]))

    monkeypatch.setattr(command, "in_own_process", measured)
    monkeypatch.setattr(sys, "argv", ["attacks", "--markdown"])
    assert command.main() == 1
    printed = capsys.readouterr()
    rows = re.findall(r"^\| `([a-z-]+)`: ", printed.out, re.MULTILINE)
    assert rows == [name for name in CASES if name != "resets"]
    assert printed.out.startswith("| attack | before |")
    assert "use the transport 'socket'" in printed.out, "readers of shared memory would bypass the host"
    assert "resets was not measured: it was killed after 192 s" in printed.err
    assert f"{len(CASES)} of {len(CASES)}: {[*CASES][-1]}" in printed.err
    monkeypatch.setattr(sys, "argv", ["attacks", "malformed"])
    assert command.main() == 0
