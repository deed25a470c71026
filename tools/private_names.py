"""Check that only one module uses the private names of PySyncObj.

Python mangles them: from outside, `__raftLog` of the class `SyncObj` is `_SyncObj__raftLog`. All other modules use the
plain names that this one module gives.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OWNER = "services/supernode/src/stampede_rt_supernode/replication/library/node.py"
# This test shows faults of the unchanged library.
BARE_LIBRARY_TEST = "tests/unit/supernode/replication/rules/test_rules_closed_faults.py"
FOLDERS = ("client/src", "services", "deploy", "demos", "benchmarks", "web", "tests")
PRIVATE = "_SyncObj__"


def intruders(modules: Iterable[tuple[str, str]]) -> list[str]:
    """Return the modules that use a private name and may not. `modules`: (path, source) of each."""
    return sorted(path for path, source in modules if PRIVATE in source and path not in (OWNER, BARE_LIBRARY_TEST))


def main() -> int:
    """Print the modules that break the rule, and return their number."""
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if ".venv" not in path.parts]
    modules = (
        (str(path.relative_to(ROOT)), path.read_text()) for path in paths if "test_private_names" not in path.name
    )
    found = intruders(modules)
    for path in found:
        print(f"{path} uses a private name of PySyncObj ({PRIVATE}...); give it a plain word in {OWNER}")
    return len(found)


if __name__ == "__main__":
    sys.exit(main())
