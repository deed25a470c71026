"""Prove that no docstring begins with a clause without its noun, such as "What was collected".

The rule is one of those under "Plain prose" in CONTRIBUTING, and the only one that a program can check exactly. A
docstring may be a question ("Who leads?").
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("client/src", "services", "benchmarks", "demos", "deploy", "tools", "web", "tests")
GENERATED = {"v1", "_sync"}  # the stubs, and the client that is derived from _async/

FIRST_WORDS = re.compile(r"(What|Whatever|Who|Whoever|Whose|Those|Of)\b(?![^.:]*\?)")
PHRASES = re.compile(r"\b([Ww]hoever|by the book)\b")


def complaints(path: str, source: str) -> Iterator[str]:
    """Yield a line for each docstring that breaks the rule."""
    for node in ast.walk(ast.parse(source)):
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            continue
        text = node.value.value
        found = (FIRST_WORDS.match(text) or PHRASES.search(text)) if isinstance(text, str) else None
        if found is not None:
            yield f'{path}:{node.lineno}: name the noun instead of "{found[1]}", see "Plain prose" in CONTRIBUTING.md'


def modules() -> Iterable[Path]:
    """Yield the modules that people write."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if GENERATED.isdisjoint(path.parts) and ".venv" not in path.parts:
                yield path


def main() -> int:
    """Print the docstrings that break the rule. Returns the exit status."""
    found = [line for path in modules() for line in complaints(str(path.relative_to(ROOT)), path.read_text())]
    for line in found:
        print(line)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
