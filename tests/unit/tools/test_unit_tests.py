"""The check that unit tests mirror the sources."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import unit_tests
from tools.unit_tests import complaints, read_sources

SOURCES = {"host": frozenset({"app", "core"}), "host/core": frozenset({"index"})}


@pytest.mark.parametrize(
    "test",
    [
        "host/test_app.py",
        "host/test_core.py",
        "host/core/__init__.py",
        "host/core/test_index.py",
        "host/core/test_index_late_items.py",
        "host/core/test_core_as_a_whole.py",
    ],
)
def test_a_test_is_found_by_the_name_of_its_module_or_folder(test: str) -> None:
    assert complaints([test], SOURCES) == []


@pytest.mark.parametrize(
    ("test", "why"),
    [
        ("host/rig.py", "is not a test; move it to tests/support"),
        ("queues/test_app.py", "mirrors no folder of the sources"),
        ("host/test_index.py", "names no module of its folder"),
        ("host/core/test_indexes.py", "names no module of its folder"),
    ],
)
def test_the_error_for_a_test_in_a_wrong_folder_names_the_right_one(test: str, why: str) -> None:
    (line,) = complaints([test], SOURCES)
    assert line.startswith(f"tests/unit/{test} {why}")


def test_folders_and_modules_are_read_from_the_sources(tmp_path: Path) -> None:
    for package in unit_tests.SOURCES.values():
        (tmp_path / package).mkdir(parents=True)
    core = tmp_path / unit_tests.SOURCES["frontend"] / "core"
    core.mkdir()
    (core.parent / "app.py").touch()
    (core / "index.py").touch()
    found = read_sources(tmp_path)
    assert (found["frontend"], found["frontend/core"]) == ({"app", "core"}, {"index"})


def test_the_unit_tests_of_this_repository_mirror_its_sources(capsys: pytest.CaptureFixture[str]) -> None:
    assert unit_tests.main() == 0, capsys.readouterr().out
