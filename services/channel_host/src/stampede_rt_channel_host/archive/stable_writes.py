"""Writes that reach the disk whole. These functions block."""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Callable, Sequence
from pathlib import Path

_VECTORS_MAX = 512  # buffers in one call of writev
_PAGE_BYTES = 4096
_SYNC_FILE_RANGE_WRITE = 2  # sync_file_range(2)


def write_all(file: int, buffers: Sequence[bytes]) -> None:
    """Write all buffers, one after the other. Raises OSError."""
    for at in range(0, len(buffers), _VECTORS_MAX):
        part = buffers[at : at + _VECTORS_MAX]
        written = os.writev(file, part)
        if written < sum(map(len, part)):  # a signal, or a disk that is nearly full
            rest = memoryview(b"".join(part))[written:]
            while rest:
                rest = rest[os.write(file, rest) :]


def start_flush(file: int, begin: int, end: int) -> int:
    """Let the system begin to bring bytes of a file to the disk, and do not wait for it. Returns where the rest begins.

    So the disk works while the caller prepares the next bytes, and a later fsync has less to do. Leaves out the last
    page if it is not full. Only that fsync brings the bytes to stable storage, and only it reports errors. On systems
    other than Linux the fsync does all the work.
    """
    end -= end % _PAGE_BYTES
    call = _sync_file_range()
    if call is None or end <= begin:
        return begin
    call(file, begin, end - begin, _SYNC_FILE_RANGE_WRITE)
    return end


@functools.cache
def _sync_file_range() -> Callable[[int, int, int, int], int] | None:
    """The system call, which the standard library of Python does not have; None: the C library has none, either."""
    call = getattr(ctypes.CDLL(None), "sync_file_range", None)
    if call is not None:
        call.argtypes = (ctypes.c_int, ctypes.c_int64, ctypes.c_int64, ctypes.c_uint)
    return call


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
