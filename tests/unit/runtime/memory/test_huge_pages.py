"""A service starts itself again with huge pages, once, and only where this changes something."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from stampede_rt_runtime.memory import huge_pages
from stampede_rt_runtime.memory.huge_pages import VARIABLE, tunables_with_huge_pages

MADVISE = "always [madvise] never\n"
HUGE = "glibc.malloc.hugetlb=1"
PROGRAM = """
import os, sys
from stampede_rt_runtime.memory import huge_pages

print(os.getpid(), flush=True)
if os.environ.get("FORGETFUL"):
    os.environ.pop(huge_pages.VARIABLE, None)
huge_pages._MODES = sys.argv[1]
huge_pages.start_again_with_huge_pages("serve", sys.argv[3:])
print("serves", os.environ.get("GLIBC_TUNABLES"))
"""


@pytest.mark.parametrize(
    ("tunables", "glibc", "modes", "wanted"),
    [
        ("", "glibc 2.36", MADVISE, HUGE),
        ("glibc.malloc.arena_max=1", "glibc 2.35", MADVISE, f"glibc.malloc.arena_max=1:{HUGE}"),
        ("glibc.malloc.hugetlb=0", "glibc 2.36", MADVISE, None),  # the operator's choice
        (HUGE, "glibc 2.36", MADVISE, None),
        ("", "glibc 2.34", MADVISE, None),
        ("", "musl 1.2", MADVISE, None),
        ("", "", MADVISE, None),
        ("", "glibc 2.36", "always madvise [never]\n", None),
        ("", "glibc 2.36", "[always] madvise never\n", None),
    ],
)
def test_the_variable_changes_only_where_the_program_has_the_choice(
    tunables: str, glibc: str, modes: str, wanted: str | None
) -> None:
    assert tunables_with_huge_pages(tunables, glibc, modes) == wanted


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library has no such variable")
@pytest.mark.parametrize(
    ("words", "starts", "value"),
    [(["serve", "--name", "h1"], 2, HUGE), (["serve"], 2, HUGE), (["other", "--name", "h1"], 1, None)],
)
def test_the_service_starts_again_once_as_the_same_process(
    words: list[str], starts: int, value: str | None, tmp_path: Path
) -> None:
    modes = f"{tmp_path}/enabled"
    with open(modes, "w") as file:
        file.write(MADVISE)
    environment = {name: one for name, one in os.environ.items() if name != VARIABLE}
    command = [sys.executable, "-c", PROGRAM, modes, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, env=environment)
    *pids, last = done.stdout.splitlines()
    assert (len(pids), len(set(pids)), last, done.stderr) == (starts, 1, f"serves {value}", "")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library has no such variable")
def test_a_program_that_loses_the_variable_at_its_start_starts_again_only_once(tmp_path: Path) -> None:
    """glibc removes the variable from a program with file capabilities."""
    modes = tmp_path / "enabled"
    modes.write_text(MADVISE)
    environment = os.environ | {"FORGETFUL": "1"}
    command = [sys.executable, "-c", PROGRAM, modes, "serve", "--name", "h1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, env=environment)
    *pids, last = done.stdout.splitlines()
    assert (len(pids), last, done.stderr) == (2, "serves None", "")


def test_the_rest_of_a_program_knows_whether_it_has_huge_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, HUGE)
    assert huge_pages.has_huge_pages()
    monkeypatch.setenv(VARIABLE, "glibc.malloc.hugetlb=0")
    assert not huge_pages.has_huge_pages()
