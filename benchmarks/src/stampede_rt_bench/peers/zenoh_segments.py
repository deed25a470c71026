"""Shared memory that ended Zenoh processes leave behind, and its removal."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FOLDER, PATTERN = Path("/dev/shm"), "*.zenoh"


@contextmanager
def segments_removed(folder: Path = FOLDER) -> Iterator[None]:
    """Remove at the end what appeared meanwhile and no process maps."""
    before = set(folder.glob(PATTERN))
    try:
        yield
    finally:
        left = set(folder.glob(PATTERN)) - before
        for path in left - _mapped(left):
            path.unlink(missing_ok=True)


def _mapped(paths: set[Path]) -> set[Path]:
    """Those that a process of this machine has mapped."""
    mapped: set[Path] = set()
    for maps in Path("/proc").glob("[0-9]*/maps") if paths else ():
        with suppress(OSError):
            text = maps.read_text(errors="replace")
            mapped |= {path for path in paths if f"{path}\n" in text}
    return mapped
