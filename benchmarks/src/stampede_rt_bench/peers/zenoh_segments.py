"""Shared memory that ended Zenoh processes leave behind, and its removal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FOLDER, PATTERN = Path("/dev/shm"), "*.zenoh"


@contextmanager
def segments_removed(folder: Path = FOLDER) -> Iterator[None]:
    """At the end of the context, remove the segments that appeared in it and that no process maps."""
    before = set(folder.glob(PATTERN))
    try:
        yield
    finally:
        left = set(folder.glob(PATTERN)) - before
        for path in left - _mapped(left):
            path.unlink(missing_ok=True)


def _mapped(paths: set[Path]) -> set[Path]:
    """Return the paths that a process of this machine has mapped."""
    mapped: set[Path] = set()
    for maps in Path("/proc").glob("[0-9]*/maps") if paths else ():
        with suppress(OSError):
            text = maps.read_text(errors="replace")
            mapped |= {path for path in paths if f"{path}\n" in text}
    return mapped
