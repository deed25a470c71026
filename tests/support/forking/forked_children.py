"""Runs a function in a forked child, with a time limit."""

from __future__ import annotations

import os
import pickle
import select
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from typing import Any

LIMIT_S = 30


def in_a_forked_child(function: Callable[[], Any]) -> Any:
    """Return the result of `function` in a forked child of this process. If the child hangs or dies, the test fails."""
    readable, writable = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns about a fork of a process with threads
        pid = os.fork()
    if pid == 0:
        _be_the_child(function, writable)
    os.close(writable)
    status = None
    try:
        result = _read(readable)
        status = os.waitpid(pid, 0)[1]  # the child has closed the pipe, and is ending
    finally:
        os.close(readable)
        if status is None:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    assert result, f"the child died without a result, with status {status}"
    return pickle.loads(result)


def _be_the_child(function: Callable[[], Any], writable: int) -> None:
    try:
        result = pickle.dumps(function())
        with os.fdopen(writable, "wb") as pipe:
            pipe.write(result)
    except BaseException:  # noqa: BLE001  # a child must not go on as pytest
        traceback.print_exc(file=sys.__stderr__)
    finally:
        os._exit(0)


def _read(readable: int) -> bytes:
    result = b""
    while select.select([readable], [], [], LIMIT_S)[0]:
        part = os.read(readable, 65536)
        if not part:
            return result
        result += part
    raise AssertionError(f"the child did not end within {LIMIT_S} s")
