"""Waits for a change of a word in shared memory, by the futex calls of Linux.

One call wakes all waiting threads of all processes.

The standard library of Python has no such call, so this module makes the system calls with ctypes.
"""

from __future__ import annotations

import ctypes
import functools
import mmap
import os
import platform
import sys
import time
from collections.abc import Sequence
from typing import Any

_FUTEX, _FUTEX_WAITV = 202, 449  # the numbers of the system calls on x86-64
_WAIT, _WAKE = 0, 1
_WORD_OF_4_BYTES = 2  # FUTEX2_SIZE_U32
_ALL = 2**31 - 1
WORDS_MAX = 128  # the most words for which one call waits
_CLOCK_MONOTONIC = 1


class _Timespec(ctypes.Structure):
    _fields_ = [("seconds", ctypes.c_long), ("nanos", ctypes.c_long)]


class _Waiter(ctypes.Structure):
    _fields_ = [
        ("value", ctypes.c_uint64), ("address", ctypes.c_uint64), ("flags", ctypes.c_uint32), ("rest", ctypes.c_uint32),
    ]  # fmt: skip


class _Buffer(ctypes.Structure):
    """Py_buffer, see the C API of Python."""

    _fields_ = [
        ("address", ctypes.c_void_p), ("object", ctypes.py_object), ("length", ctypes.c_ssize_t),
        ("item_bytes", ctypes.c_ssize_t), ("is_readonly", ctypes.c_int), ("dimensions", ctypes.c_int),
        ("format", ctypes.c_char_p), ("shape", ctypes.c_void_p), ("strides", ctypes.c_void_p),
        ("suboffsets", ctypes.c_void_p), ("internal", ctypes.c_void_p),
    ]  # fmt: skip


@functools.cache
def is_supported() -> bool:
    """Whether this program can share memory with others: on Linux, x86-64 and CPython."""
    return (
        sys.platform == "linux"
        and platform.machine() in ("x86_64", "AMD64")
        and sys.implementation.name == "cpython"
        and sys.maxsize > 2**32
        and hasattr(os, "memfd_create")
    )


@functools.cache
def _system_call() -> Any:
    call = ctypes.CDLL(None, use_errno=True).syscall
    call.restype = ctypes.c_long
    return call


@functools.cache
def _buffer_calls() -> tuple[Any, Any]:
    """PyObject_GetBuffer and PyBuffer_Release, as objects of this module alone.

    The objects of `ctypes.pythonapi` belong to the whole process. If a thread sets their argument types while another
    thread calls them, Python may use types that it has freed.
    """
    get = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.py_object, ctypes.POINTER(_Buffer), ctypes.c_int)
    release = ctypes.PYFUNCTYPE(None, ctypes.POINTER(_Buffer))
    return get(("PyObject_GetBuffer", ctypes.pythonapi)), release(("PyBuffer_Release", ctypes.pythonapi))


def address_of(memory: mmap.mmap) -> int:
    """Return the address of a mapping. It is valid as long as the mapping is open."""
    get, release = _buffer_calls()
    buffer = _Buffer()
    get(memory, ctypes.byref(buffer), 0)
    address = int(buffer.address)
    release(ctypes.byref(buffer))
    return address


def wait(address: int, value: int, timeout_s: float) -> None:
    """Wait while the word at `address` has `value`, for at most `timeout_s`. It may return earlier without a reason."""
    limit = _Timespec(int(timeout_s), int(timeout_s % 1 * 1e9))
    _system_call()(
        ctypes.c_long(_FUTEX), ctypes.c_void_p(address), ctypes.c_long(_WAIT), ctypes.c_uint32(value & 0xFFFF_FFFF),
        ctypes.byref(limit), ctypes.c_void_p(), ctypes.c_long(0),
    )  # fmt: skip


def wake(address: int) -> None:
    """Wake all threads of all processes that wait for the word at `address`. The memory may be read-only here."""
    _system_call()(
        ctypes.c_long(_FUTEX), ctypes.c_void_p(address), ctypes.c_long(_WAKE), ctypes.c_long(_ALL),
        ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_long(0),
    )  # fmt: skip


def wait_for_any(words: Sequence[tuple[int, int]], timeout_s: float) -> None:
    """Wait while all these words have their values, for at most `timeout_s`. Each is an address and a value.

    There are at most WORDS_MAX. Raises OSError if the system has no such call.
    """
    waiters = (_Waiter * len(words))(*(_Waiter(value & 0xFFFF_FFFF, at, _WORD_OF_4_BYTES, 0) for at, value in words))
    deadline_s = time.monotonic() + timeout_s
    limit = _Timespec(int(deadline_s), int(deadline_s % 1 * 1e9))
    result = _system_call()(
        ctypes.c_long(_FUTEX_WAITV), ctypes.byref(waiters), ctypes.c_long(len(words)), ctypes.c_long(0),
        ctypes.byref(limit), ctypes.c_long(_CLOCK_MONOTONIC),
    )  # fmt: skip
    if result < 0 and ctypes.get_errno() in _NO_CALL:
        raise OSError(ctypes.get_errno(), "the system has no futex_waitv")


_NO_CALL = (1, 22, 38)  # EPERM, EINVAL and ENOSYS: a sandbox forbids the call, or Linux is older than 5.16
