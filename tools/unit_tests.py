"""Check that the unit tests mirror the sources, so that the name of a module leads to its tests.

The tests of `<package>/<folder>/<module>.py` are `tests/unit/<name of the package>/<folder>/test_<module>.py`.
A topic may follow: `test_<module>_<topic>.py`. Tests of a whole folder have its name: `test_<folder>_<topic>.py`.
Helpers are in tests/support.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parent.parent
UNIT_TESTS = "tests/unit"
SOURCES = {
    "benchmarks": "benchmarks/src/stampede_rt_bench",
    "channel_host": "services/channel_host/src/stampede_rt_channel_host",
    "client": "client/src/stampede_rt",
    "demos": "demos/src/stampede_rt_demos",
    "frontend": "services/frontend/src/stampede_rt_frontend",
    "local_cluster": "deploy/local_cluster/src/stampede_rt_local",
    "runtime": "services/runtime/src/stampede_rt_runtime",
    "supernode": "services/supernode/src/stampede_rt_supernode",
    "tools": "tools",
    "web": "web/src/stampede_rt_web",
}


def complaints(tests: Iterable[str], sources: Mapping[str, frozenset[str]]) -> list[str]:
    """Return the tests that are at a wrong place.

    `tests`: the paths below tests/unit. `sources`: by each folder that tests may mirror, the names of its modules and
    folders.
    """
    return [line for test in sorted(tests) if (line := _complaint(PurePosixPath(test), sources))]


def _complaint(test: PurePosixPath, sources: Mapping[str, frozenset[str]]) -> str:
    folder, name = str(test.parent), test.stem
    if name == "__init__":
        return ""
    if not name.startswith("test_"):
        return f"{UNIT_TESTS}/{test} is not a test; move it to tests/support"
    if folder not in sources:
        return f"{UNIT_TESTS}/{test} mirrors no folder of the sources; move it beside the tests of its module's folder"
    subject = name.removeprefix("test_")
    known = sources[folder] | {test.parent.name}
    if not any(subject == one or subject.startswith(f"{one}_") for one in known):
        return f"{UNIT_TESTS}/{test} names no module of its folder; call it test_MODULE.py or test_MODULE_TOPIC.py"
    return ""


def read_sources(root: Path) -> dict[str, frozenset[str]]:
    """Map each possible folder below tests/unit to the modules and folders of the sources that it mirrors."""
    found: dict[str, frozenset[str]] = {}
    for name, package in SOURCES.items():
        top = root / package
        for folder in [top, *(path for path in top.rglob("*") if path.is_dir() and path.name != "__pycache__")]:
            mirrored = PurePosixPath(name, folder.relative_to(top).as_posix())
            found[str(mirrored)] = frozenset(path.stem for path in folder.iterdir() if path.suffix in (".py", ""))
    return found


def main() -> int:
    """Print each complaint. Returns 1 if there is one."""
    top = ROOT / UNIT_TESTS
    tests = [path.relative_to(top).as_posix() for path in top.rglob("*.py")]
    lines = complaints(tests, read_sources(ROOT))
    for line in lines:
        print(line)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
