"""Shares of test files. pytest-xdist gives all files of a share to the same worker.

So these files can share a costly thing, such as a cluster, that ends with the last test of the share.
"""

from __future__ import annotations

import functools
import re
from contextlib import ExitStack
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
FILES_PER_SHARE = 7
_SHARES_CLUSTER = re.compile(r"^cluster = shared_cluster_fixture\((.*)\)", re.MULTILINE)

at_end_of_share = ExitStack()
"""The things that end after the last test of the share whose tests run at present."""


def share_of(test: str) -> str:
    """Return the name of the share to which a test belongs, from its id. Most files are a share of their own."""
    path = test.split("::", 1)[0]
    return _shares().get(path, path)


@functools.cache
def _shares() -> dict[str, str]:
    """The names of the shares of several files, by the path of each file."""
    sharing: dict[str, list[str]] = {}
    for folder in ("contract", "integration"):
        for file in sorted((ROOT / "tests" / folder).rglob("test_*.py")):
            if cluster := _shared_cluster(folder, file.read_text()):
                sharing.setdefault(cluster, []).append(file.relative_to(ROOT).as_posix())
    return {
        path: f"share {at // FILES_PER_SHARE + 1} of {cluster}"
        for cluster, paths in sharing.items()
        for at, path in enumerate(paths)
    }


def _shared_cluster(folder: str, text: str) -> str:
    """The cluster that a file with this text shares with other files; empty if it shares none."""
    if folder == "contract":
        return "the contract of groups" if "grouped_cluster" in text else "the contract"
    found = _SHARES_CLUSTER.search(text)
    return f"a cluster with {found[1]}" if found else ""
