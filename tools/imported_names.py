"""Check that each name that a module of the tests imports from another module of the tests exists there.

mypy does not read the tests. Without this check, only a run of the suite finds a rename that misses one file.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDER = "tests"


def complaints(sources: Mapping[str, str]) -> list[str]:
    """Return the imports of names that do not exist. `sources`: the source of each module, by its dotted name."""
    trees = {name: ast.parse(source) for name, source in sources.items()}
    defined = {name: _names_of(tree) for name, tree in trees.items()}
    for name in sources:
        parent, _, last = name.rpartition(".")
        defined.setdefault(parent, set()).add(last)
    return [
        f"{importer}, line {node.lineno}: {node.module} has no {alias.name}"
        for importer, tree in sorted(trees.items())
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] == FOLDER
        for alias in node.names
        if alias.name not in defined.get(node.module, set())
    ]


def _names_of(tree: ast.Module) -> set[str]:
    """Return the names that a module may have: of its definitions, assignments and imports, at any depth."""
    found: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
            case ast.Name(id=name, ctx=ast.Store()):
                found.add(name)
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                found |= {(alias.asname or alias.name).partition(".")[0] for alias in aliases}
    return found


def main() -> int:
    """Print the imports of names that do not exist, and return their number."""
    paths = (ROOT / FOLDER).rglob("*.py")
    sources = {".".join(path.relative_to(ROOT).with_suffix("").parts): path.read_text() for path in paths}
    found = complaints({name.removesuffix(".__init__"): source for name, source in sources.items()})
    for line in found:
        print(line)
    return min(len(found), 100)


if __name__ == "__main__":
    sys.exit(main())
