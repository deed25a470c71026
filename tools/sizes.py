"""Check the sizes of the hand-written sources: lines of files and functions, and files in a folder of tests.

A file or function above the limit fails the check, unless `sizes.toml` allows its size and gives a reason. An entry for
a file or function that has become shorter fails, too, so the list only becomes shorter. Of all functions, half have at
most MEDIAN_LINES_MAX lines, and nine tenths at most LINES_OF_MOST.
"""

from __future__ import annotations

import ast
import statistics
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parent.parent
LISTS = Path(__file__).with_name("sizes.toml")
FOLDERS = ("client/src", "services", "benchmarks", "demos", "deploy", "tools", "web")
GENERATED = {"v1", "_sync"}  # the stubs, and the client that is derived from _async/

FILE_LINES_MAX = 354
FUNCTION_LINES_MAX = 45  # with the docstring, without decorators
MEDIAN_LINES_MAX = 6
LINES_OF_MOST = 16  # at most a tenth of the functions have more
TEST_MODULES_MAX = 25  # in one folder of tests; its subfolders count by themselves


@dataclass(frozen=True)
class Sizes:
    """Lines of files by path, and of functions by `path::name`."""

    files: Mapping[str, int] = field(default_factory=dict)
    functions: Mapping[str, int] = field(default_factory=dict)


def measure(modules: Iterable[tuple[str, str]]) -> Sizes:
    """Measure modules, each given as (path, source). The name of a nested function begins with the names around it."""
    files: dict[str, int] = {}
    functions: dict[str, int] = {}
    for path, source in modules:
        files[path] = len(source.splitlines())
        for name, lines in _functions(ast.parse(source), ""):
            functions[f"{path}::{name}"] = max(lines, functions.get(f"{path}::{name}", 0))
    return Sizes(files, functions)


def _functions(parent: ast.AST, prefix: str) -> Iterator[tuple[str, int]]:
    for node in ast.iter_child_nodes(parent):
        name = prefix
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{prefix}{node.name}."
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield name.removesuffix("."), (node.end_lineno or node.lineno) - node.lineno + 1
        yield from _functions(node, name)


def complaints(found: Sizes, allowed: Sizes) -> list[str]:
    """Return the files and functions above their limits, the entries that are no longer needed, and bad averages."""
    lines = _too_long("file", found.files, allowed.files, FILE_LINES_MAX)
    lines += _too_long("function", found.functions, allowed.functions, FUNCTION_LINES_MAX)
    lengths = list(found.functions.values())
    median, longer = statistics.median(lengths), sum(one > LINES_OF_MOST for one in lengths)
    if median > MEDIAN_LINES_MAX:
        lines.append(f"the median of all functions is {median:g} lines, allowed {MEDIAN_LINES_MAX}; shorten some")
    if 10 * longer > len(lengths):
        lines.append(
            f"{longer} of {len(lengths)} functions, more than a tenth, have more than {LINES_OF_MOST} lines; "
            f"shorten some of those with {LINES_OF_MOST + 1} to {LINES_OF_MOST + 3}"
        )
    return lines


def _too_long(kind: str, found: Mapping[str, int], allowed: Mapping[str, int], most: int) -> list[str]:
    lines = []
    for name in sorted(found.keys() | allowed.keys()):
        now, listed = found.get(name, 0), allowed.get(name, 0)
        if now > max(most, listed):
            lines.append(f"the {kind} {name} has {now} lines, allowed {max(most, listed)}; split it by its tasks")
        elif listed and now < listed:
            lines.append(
                f"the {kind} {name} has {now} lines, and {LISTS.name} says {listed}; correct or delete the entry"
            )
    return lines


def crowded(tests: Iterable[str]) -> list[str]:
    """Return the folders that have too many modules. `tests`: the paths of all modules of the tests."""
    counts = Counter(str(PurePosixPath(path).parent) for path in tests if not path.endswith("__init__.py"))
    return [
        f"{folder}/ has {count} modules, allowed {TEST_MODULES_MAX}; put some into a subfolder for their subject"
        for folder, count in sorted(counts.items())
        if count > TEST_MODULES_MAX
    ]


def read_lists(text: str) -> Sizes:
    """Read the allowed sizes; an entry without a reason raises ValueError."""
    tables = tomllib.loads(text)
    for entries in tables.values():
        for name, entry in entries.items():
            if not entry["why"].strip():
                raise ValueError(f"the allowed size of {name} needs a reason")
    return Sizes(*({name: one["lines"] for name, one in tables[table].items()} for table in ("files", "functions")))


def sources(root: Path) -> Iterator[tuple[str, str]]:
    """Yield the path and the text of every hand-written module of FOLDERS."""
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            if not GENERATED & set(path.relative_to(root).parts):
                yield path.relative_to(root).as_posix(), path.read_text()


def main() -> int:
    """Print each complaint, then the sizes. Returns 1 if there is a complaint."""
    found = measure(sources(ROOT))
    tests = [path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("*.py")]
    lines = complaints(found, read_lists(LISTS.read_text())) + crowded(tests)
    for line in lines:
        print(line)
    lengths = sorted(found.functions.values())
    percentile_90 = lengths[len(lengths) * 9 // 10]
    print(
        f"{len(found.files)} files of at most {max(found.files.values())} lines; {len(lengths)} functions of at most "
        f"{lengths[-1]} lines, median {statistics.median(lengths):g}, nine tenths at most {percentile_90}"
    )
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
