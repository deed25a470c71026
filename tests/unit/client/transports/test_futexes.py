"""The address of mapped memory, which the client gets from Python's own C functions."""

from __future__ import annotations

import ctypes
import mmap

import pytest

from stampede_rt.transports import futexes

WORD_BYTES = 8


def test_the_address_belongs_to_the_mapped_bytes() -> None:
    with mmap.mmap(-1, mmap.PAGESIZE) as memory:
        memory[:WORD_BYTES] = (12345).to_bytes(WORD_BYTES, "little")
        assert ctypes.c_uint64.from_address(futexes.address_of(memory)).value == 12345


def test_the_view_is_released_so_that_the_mapping_can_close() -> None:
    memory = mmap.mmap(-1, mmap.PAGESIZE)
    futexes.address_of(memory)
    memory.close()
    with pytest.raises(ValueError, match="closed"):
        futexes.address_of(memory)


def test_functions_that_other_code_uses_at_the_same_time_stay_unchanged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, each call set the argument types that another thread was perhaps using."""
    shared = [getattr(ctypes.pythonapi, name) for name in ("PyObject_GetBuffer", "PyBuffer_Release")]
    other_types = [(ctypes.py_object, ctypes.c_void_p, ctypes.c_int), (ctypes.c_void_p,)]
    for one, types in zip(shared, other_types, strict=True):
        monkeypatch.setattr(one, "argtypes", types)
    with mmap.mmap(-1, mmap.PAGESIZE) as memory:
        futexes.address_of(memory)
    assert [one.argtypes for one in shared] == other_types
