"""The guard of sizes: files and functions stay short, and no folder of tests is too full to look through."""

from __future__ import annotations

import pytest

from tools import sizes
from tools.sizes import FILE_LINES_MAX, FUNCTION_LINES_MAX, TEST_MODULES_MAX, Sizes, complaints, crowded, read_lists

SHORT = {f"a.py::f{number}": 5 for number in range(100)}


def function_of(lines: int) -> str:
    """A function with this number of lines."""
    return "def long():\n" + "    pass\n" * (lines - 1)


def test_a_function_is_measured_with_its_docstring_and_without_its_decorators() -> None:
    source = (
        'class A:\n    @property\n    def b(self):\n        """One.\n\n        Two.\n        """\n        return 1\n'
    )
    assert sizes.measure([("a.py", source)]) == Sizes({"a.py": 8}, {"a.py::A.b": 6})


def test_a_nested_function_has_the_name_of_its_outer_one_in_front() -> None:
    source = "def outer():\n    if True:\n        async def inner():\n            pass\n    return inner\n"
    assert sizes.measure([("a.py", source)]).functions == {"a.py::outer": 5, "a.py::outer.inner": 2}


def test_the_longer_of_two_functions_with_one_name_counts() -> None:
    assert sizes.measure([("a.py", function_of(9) + function_of(4))]).functions == {"a.py::long": 9}


@pytest.mark.parametrize(("kind", "most"), [("files", FILE_LINES_MAX), ("functions", FUNCTION_LINES_MAX)])
def test_one_line_above_the_limit_is_reported(kind: str, most: int) -> None:
    assert complaints(found(kind, most), Sizes()) == []
    (line,) = complaints(found(kind, most + 1), Sizes())
    assert f"long has {most + 1} lines, allowed {most}; split it" in line


@pytest.mark.parametrize(("kind", "most"), [("files", FILE_LINES_MAX), ("functions", FUNCTION_LINES_MAX)])
def test_an_allowed_size_may_not_grow_and_must_shrink_with_the_file_or_function(kind: str, most: int) -> None:
    allowed = Sizes(**{kind: {"long": most + 10}})
    assert complaints(found(kind, most + 10), allowed) == []
    assert "split it" in complaints(found(kind, most + 11), allowed)[0]
    assert "correct or delete the entry" in complaints(found(kind, most + 9), allowed)[0]
    assert "correct or delete the entry" in complaints(Sizes(functions=SHORT), allowed)[0]


def found(kind: str, lines: int) -> Sizes:
    """Many short functions, and one file or function with this number of lines."""
    return Sizes(functions=SHORT | {"long": lines}) if kind == "functions" else Sizes({"long": lines}, SHORT)


def test_many_long_functions_are_reported_even_if_each_is_allowed() -> None:
    long = {f"a.py::g{number}": 17 for number in range(12)}
    (line,) = complaints(Sizes(functions=SHORT | long), Sizes())
    assert "12 of 112 functions, more than a tenth" in line
    assert complaints(Sizes(functions=SHORT | dict(list(long.items())[:11])), Sizes()) == []


def test_a_median_that_rises_is_reported() -> None:
    (line,) = complaints(Sizes(functions=dict.fromkeys(SHORT, 7)), Sizes())
    assert "median" in line


def test_a_folder_of_tests_with_too_many_modules_is_reported() -> None:
    modules = ["tests/a/__init__.py", *(f"tests/a/test_{number}.py" for number in range(TEST_MODULES_MAX))]
    assert crowded(modules) == []
    assert crowded([*modules, "tests/a/b/test_more.py"]) == []
    (line,) = crowded([*modules, "tests/a/conftest.py"])
    assert line.startswith("tests/a/ has 26 modules")


def test_an_allowed_size_needs_a_reason() -> None:
    with pytest.raises(ValueError, match=r"a\.py needs a reason"):
        read_lists('[files]\n"a.py" = { lines = 400, why = " " }\n[functions]\n')
