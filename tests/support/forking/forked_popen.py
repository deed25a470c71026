"""`subprocess.Popen` that forks a loaded process for a service, instead of a new Python that loads its modules.

It takes 0.15 to 0.3 s of CPU time to load the modules: most of the start of a service. The suite starts hundreds of
services. The fork runs the same `main`, as a process of its own, and is a child of the tests. `tests/conftest.py`
gives this class to `ServiceProcess`. `stampede dev`, the supernodes of `tests/support/supernode` and hosts in a network
of their own start as a user starts them.
"""

from __future__ import annotations

import atexit
import ctypes
import functools
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.support.forking import loaded_process

_WATCHED = (sys.executable, "-P", "-m", "stampede_rt_runtime.parent_watch")
_READ_AT_START = ("PYTHON", "GRPC_", "MALLOC_", "LD_", "LC_", "LANG", "TZ", "OPENSSL_")
_FORK_S_MAX = 120  # a fork takes milliseconds; a busy machine may take seconds
_PR_SET_CHILD_SUBREAPER = 36  # prctl(2)
_one_at_a_time = threading.Lock()


class ForkedPopen(subprocess.Popen[bytes]):
    """A process. It is a fork if its command starts a service with the environment of the tests."""

    def _execute_child(self, args: Sequence[str], *others: Any) -> None:
        # Popen has made the pipes, and calls this private method to start the process.
        folder, environment = others[4:6]
        if not _can_fork(args, environment):
            super()._execute_child(args, *others)  # type: ignore[misc]
            return
        pipes = others[9:15]  # the two ends for each of stdin, stdout and stderr
        request = {
            "arguments": args[len(_WATCHED) :],
            "environment": dict(environment),
            "folder": folder or os.getcwd(),
        }
        self.pid = _fork(json.dumps(request).encode(), [pipes[0], pipes[3], pipes[5]])
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]


def _can_fork(command: Sequence[str], environment: Mapping[str, str] | None) -> bool:
    """Whether a fork would behave like a new process.

    An environment that Python reads at its start must be the environment of the tests.
    """
    service = command[len(_WATCHED)] if tuple(command[: len(_WATCHED)]) == _WATCHED else ""
    is_same = environment is not None and _read_at_start(environment) == _loaded_environment()
    return sys.platform == "linux" and service in loaded_process.SERVICES and is_same


def _read_at_start(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name.startswith(_READ_AT_START)}


@functools.cache
def _loaded_environment() -> dict[str, str]:
    return _read_at_start(os.environ)


def _fork(request: bytes, streams: list[int]) -> int:
    """Have the loaded process fork, and return the process id of the fork, which is a child of this process."""
    with _one_at_a_time:
        calls = _loaded_process()
        # From here to the answer the kernel makes this process the parent of its orphaned descendants.
        _set_subreaper(1)
        try:
            socket.send_fds(calls, [request], streams)
            answer = calls.recv(32)
        except BaseException:
            # The answer may still come, and the next caller would take it for its own. So the next caller gets another
            # process.
            calls.close()
            _loaded_process.cache_clear()
            raise
        finally:
            _set_subreaper(0)
    if not answer:
        raise OSError("the loaded process has ended")
    return int(answer)


def _set_subreaper(value: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_CHILD_SUBREAPER, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")


@functools.cache
def _loaded_process() -> socket.socket:
    """Start the loaded process of these tests, and return the socket to it. The process ends with the socket."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
    with its:
        process = subprocess.Popen(
            [sys.executable, "-P", str(Path(loaded_process.__file__)), str(its.fileno())],
            pass_fds=[its.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env=environment,
        )
    ours.settimeout(_FORK_S_MAX)
    atexit.register(process.wait)
    atexit.register(process.kill)
    atexit.register(ours.close)
    return ours
