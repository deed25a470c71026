"""Writes that reach the disk whole. These functions block."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

_VECTORS_MAX = 512  # buffers in one call of writev


def write_all(file: int, buffers: Sequence[bytes]) -> None:
    """Write all buffers, one after the other. Raises OSError."""
    for at in range(0, len(buffers), _VECTORS_MAX):
        part = buffers[at : at + _VECTORS_MAX]
        written = os.writev(file, part)
        if written < sum(map(len, part)):  # a signal, or a disk that is nearly full
            rest = memoryview(b"".join(part))[written:]
            while rest:
                rest = rest[os.write(file, rest) :]


def sync_folder(folder: Path) -> None:
    """Bring the names of the files in a folder to stable storage. Raises OSError."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def make_folder(folder: Path) -> None:
    """Make a folder of mode 0700 and its parents, and bring their names to stable storage. Raises OSError."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)  # `mode` does not apply to the parents
    for made in missing:
        sync_folder(made.parent)
