"""Takes all pages of mapped memory in one call. Otherwise the first use of each page costs a fault of a microsecond."""

from __future__ import annotations

import ctypes
import functools
import mmap
from typing import Any

from stampede_rt.transports.futexes import address_of

_POPULATE_READ, _POPULATE_WRITE = 22, 23  # advice values of madvise, since Linux 5.14


@functools.cache
def _advise() -> Any:
    call = ctypes.CDLL(None).madvise
    call.argtypes = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
    return call


def take_pages(memory: mmap.mmap, *, to_write: bool) -> bool:
    """Map all pages for reads, or for writes too. Takes about 0.2 ms for a MiB, without the interpreter's lock.

    Returns False if the system refuses. It then maps each page at its first use, as an older system does.
    """
    advice = _POPULATE_WRITE if to_write else _POPULATE_READ
    return bool(_advise()(address_of(memory), len(memory), advice) == 0)
