"""Find class names that the distributions use for more than one thing.

Two classes with one name are accepted in three cases: one is the blocking counterpart of the other in the client or its
transports; `class_names.toml` allows the name and gives a reason; or it lists the name as one to be renamed. Any other
duplicate fails the check. An entry that is no longer needed also fails it, so the lists only become shorter.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LISTS = Path(__file__).with_name("class_names.toml")
GENERATED = {"v1", "_sync"}  # the stubs, and the client that is derived from _async/
TWINS = re.compile(r"_(async|sync)\.py$")


@dataclass(frozen=True)
class AcceptedNames:
    """The names that several classes may have, each with the number of classes."""

    allowed: Mapping[str, int]
    to_rename: Mapping[str, int]


def sources(root: Path) -> list[Path]:
    """Return every hand-written module of the distributions in the workspace."""
    workspace = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["uv"]["workspace"]
    members = sorted(folder for pattern in workspace["members"] for folder in root.glob(pattern))
    return [
        path
        for member in members
        for path in sorted((member / "src").rglob("*.py"))
        if not GENERATED & set(path.relative_to(root).parts)
    ]


def public_classes(source: str) -> list[str]:
    """Return the names of the public classes of a module: the classes without a leading underscore."""
    return [
        node.name for node in ast.parse(source).body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]


def duplicates(modules: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return the class names that occur more than once, each with its modules. `modules`: (path, source) of each."""
    places: dict[str, dict[str, str]] = defaultdict(dict)
    for path, source in modules:
        for name in public_classes(source):
            places[name].setdefault(TWINS.sub(".py", path), path)
    return {name: sorted(found.values()) for name, found in sorted(places.items()) if len(found) > 1}


def complaints(found: Mapping[str, list[str]], accepted: AcceptedNames) -> list[str]:
    """Return the differences between the found duplicates and the accepted ones."""
    lines = [
        f"{name} is both allowed and to be renamed; keep one entry"
        for name in accepted.allowed.keys() & accepted.to_rename.keys()
    ]
    counts = {**accepted.to_rename, **accepted.allowed}
    for name in sorted(found.keys() | counts.keys()):
        now, listed = len(found.get(name, ())), counts.get(name, 0)
        if now > max(listed, 1):
            lines.append(f"class {name} is defined in {', '.join(found[name])}; give the new class another name")
        elif now < listed:
            lines.append(f"class {name} has fewer meanings than {LISTS.name} says; correct or delete its entry")
    return lines


def read_lists(text: str) -> AcceptedNames:
    """Read the accepted names; an allowed name without a reason raises ValueError."""
    tables = tomllib.loads(text)
    for name, entry in tables["allowed"].items():
        if not entry["why"].strip():
            raise ValueError(f"the allowed class name {name} needs a reason")
    return AcceptedNames({name: entry["places"] for name, entry in tables["allowed"].items()}, tables["to_rename"])


def main() -> int:
    """Print each complaint, then the counts. Returns 1 if there is a complaint."""
    found = duplicates((str(path.relative_to(ROOT)), path.read_text()) for path in sources(ROOT))
    accepted = read_lists(LISTS.read_text())
    lines = complaints(found, accepted)
    for line in lines:
        print(line)
    print(f"{len(found)} class names are used for several things; {len(accepted.allowed)} of them are allowed")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
