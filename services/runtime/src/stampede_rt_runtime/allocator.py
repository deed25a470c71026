"""How this process gives memory back to the system. glibc: mallopt(3); elsewhere nothing is set."""

from __future__ import annotations

import contextlib
import ctypes
import resource
import threading
from pathlib import Path

# malloc.h
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8

OWN_MAPPING_BYTES = 2**20
"""A block from this size on has a mapping of its own, which ends with it. By default the bound rises to 32 MiB with the
first large blocks that are freed; from then on the large ones lie between the small ones, and what is freed stays."""
ARENAS_MAX = 2
"""Otherwise each thread that allocates beside others gets an arena of its own, which keeps what was freed in it."""


TRIM_SECONDS = 1.0
UNUSED_BYTES_MAX = 64 * 2**20


def give_back_memory() -> None:
    """Keep what this process holds of the system's memory near to what it uses. Before other threads start."""
    with contextlib.suppress(AttributeError, OSError):  # another C library
        library = ctypes.CDLL(None)
        library.mallinfo2.restype = _Mallinfo2
        library.mallopt(_M_MMAP_THRESHOLD, OWN_MAPPING_BYTES)
        library.mallopt(_M_ARENA_MAX, ARENAS_MAX)
        threading.Thread(target=_trim_now_and_then, args=(library,), name="allocator", daemon=True).start()


_FIELDS = ["arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"]


class _Mallinfo2(ctypes.Structure):
    """mallinfo(3)."""

    _fields_ = tuple((name, ctypes.c_size_t) for name in _FIELDS)


def _trim_now_and_then(library: ctypes.CDLL) -> None:
    """Small blocks that were freed between others go back once they are many. Others wait only if they allocate."""
    least_bytes = _unused_bytes(library)
    wait = threading.Event().wait
    while not wait(TRIM_SECONDS):
        unused_bytes = _unused_bytes(library)
        if unused_bytes > least_bytes + UNUSED_BYTES_MAX:
            library.malloc_trim(0)
            least_bytes = _unused_bytes(library)
        least_bytes = min(least_bytes, unused_bytes)


def _unused_bytes(library: ctypes.CDLL) -> int:
    """The resident memory that malloc does not use: free blocks, beside code and other mappings (proc_pid_statm(5))."""
    resident_bytes = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    told = library.mallinfo2()
    return int(resident_bytes - told.uordblks - told.hblkhd)
