"""Makes this process return freed memory to the system. With a C library other than glibc it does nothing."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import threading

from stampede_rt_runtime.memory import huge_pages

# malloc.h
_M_TRIM_THRESHOLD = -1
_M_TOP_PAD = -2
_M_MMAP_THRESHOLD = -3
_M_ARENA_MAX = -8

OWN_MAPPING_BYTES = 2**21
"""A block of this size or more has a mapping of its own, which ends with the block.

By default the threshold rises to 32 MiB when the first large blocks are freed. From then on large blocks are between
small ones, and freed memory stays in the process. Usual messages have about 1 MiB at most, so they get no mapping. A
mapping would cost a page fault for each 4 KiB.
"""
KEPT_BYTES_MAX = 2**24
"""The free memory at the end of an arena that stays in the process.

With the usual 128 KiB each large message takes memory from the system and returns it, with a page fault for each 4 KiB.
"""
GROWTH_BYTES = 2**24
"""By how much more than needed malloc takes memory from the system, if the process has huge pages.

The kernel provides a huge page only if malloc has taken all of it. Unused memory is not resident.
"""
ARENAS_MAX = 2
"""The most arenas of malloc.

By default each allocating thread gets an arena of its own, which keeps its freed memory.
"""


TRIM_SECONDS = 1.0
"""The time between two looks at the unused memory."""
UNUSED_BYTES_MAX = 64 * 2**20
"""If the unused memory is greater than its least amount so far by more than this, the process returns it to the
system.
"""

_STATM_BYTES_MAX = 256


def give_back_memory() -> None:
    """From now on return freed memory to the system soon. Call it before other threads start."""
    with contextlib.suppress(AttributeError, OSError):  # another C library
        library = ctypes.CDLL(None)
        library.mallinfo2.restype = _Mallinfo2
        library.mallopt(_M_MMAP_THRESHOLD, OWN_MAPPING_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES_MAX)
        library.mallopt(_M_ARENA_MAX, ARENAS_MAX)
        if huge_pages.has_huge_pages():
            library.mallopt(_M_TOP_PAD, GROWTH_BYTES)
        statm = os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)
        threading.Thread(target=_trim_now_and_then, args=(library, statm), name="allocator", daemon=True).start()


_FIELDS = ["arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"]


class _Mallinfo2(ctypes.Structure):
    """mallinfo(3)."""

    _fields_ = tuple((name, ctypes.c_size_t) for name in _FIELDS)


def _trim_now_and_then(library: ctypes.CDLL, statm: int) -> None:
    """Return the memory of freed small blocks to the system when there is much of it. Runs without end, on a thread."""
    least_bytes = _unused_bytes(library, statm)
    wait = threading.Event().wait
    while not wait(TRIM_SECONDS):
        unused_bytes = _unused_bytes(library, statm)
        if unused_bytes > least_bytes + UNUSED_BYTES_MAX:
            library.malloc_trim(0)
            least_bytes = _unused_bytes(library, statm)
        least_bytes = min(least_bytes, unused_bytes)


def _unused_bytes(library: ctypes.CDLL, statm: int) -> int:
    """The resident memory outside malloc's used blocks: free blocks, code and other mappings (proc_pid_statm(5)).

    `statm`: the descriptor of the process's statm file. It stays open, because the process may have no descriptor left
    when this function reads the file.
    """
    resident_bytes = int(os.pread(statm, _STATM_BYTES_MAX, 0).split()[1]) * resource.getpagesize()
    used = library.mallinfo2()
    return int(resident_bytes - used.uordblks - used.hblkhd)
