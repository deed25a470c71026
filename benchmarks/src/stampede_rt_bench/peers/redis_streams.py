"""Redis streams, through redis-py with hiredis: XADD in pipelines, XREAD with COUNT, as its docs advise.

Redis keeps items in memory only, as the other systems do. The id of an entry is its time in milliseconds, and a number.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from stampede_rt_bench.peers.reachable import is_listening
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds
from stampede_rt_bench.workloads.processes import server
from stampede_rt_local.ports import free_ports

SERVER = "redis-server"
STREAM, FIELD = b"bench", b"p"
WAIT_MILLIS, NANOS_PER_MS = 100, 1_000_000


@dataclass(frozen=True)
class RedisStreams:
    """One stream of one server, reached over TCP or a Unix socket."""

    family: Literal["tcp", "unix"]

    @property
    def name(self) -> str:
        """The name of the system in tables."""
        return {"tcp": "Redis", "unix": "Redis, Unix socket"}[self.family]

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return an empty mapping: the system can run every kind of workload."""
        return {}

    def unavailable_because(self) -> str | None:
        """Return which part is missing, and how to install it; None if none is missing."""
        if shutil.which(SERVER) is None:
            return f"{SERVER} is not installed; Debian has it: apt-get install redis-server"
        if find_spec("redis") is None:
            return 'the client is not installed; pip install "stampede-rt-bench[peers]"'
        return None

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run a server that writes nothing to disk for the duration of the context."""
        with tempfile.TemporaryDirectory(prefix="stampede-bench-") as folder:
            (port,) = free_ports(1, "127.0.0.1")
            path = Path(folder, "socket")
            listen = ["--port", str(port), "--bind", "127.0.0.1", "--unixsocket", str(path)]
            command = [SERVER, *listen, "--save", "", "--appendonly", "no", "--dir", folder]
            with server(command, Path(folder, "log"), partial(is_listening, port)) as pid:
                yield RunningServer(address=str(path) if self.family == "unix" else str(port), pids=[pid])

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> RedisClient:
        """Return a client with a new connection."""
        import redis

        if self.family == "unix":
            return RedisClient(redis.Redis(unix_socket_path=served.address, protocol=2), needs)
        return RedisClient(redis.Redis(host="127.0.0.1", port=int(served.address), protocol=2), needs)


class RedisClient:
    """A blocking client."""

    def __init__(self, client: Any, needs: WorkloadNeeds) -> None:
        self._client, self._needs = client, needs
        client.ping()

    def put(self, payloads: Iterator[bytes]) -> None:
        """Send one XADD for each payload, and wait for its answer."""
        for payload in payloads:
            self._client.xadd(STREAM, {FIELD: payload}, maxlen=self._needs.items_max, approximate=True)

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the newest entry with XREVRANGE and a count of 1."""
        for _ in turns:
            _take(self._client.xrevrange(STREAM, count=1), receiver)

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the oldest entries with XRANGE and a count."""
        for items in turns:
            _take(self._client.xrange(STREAM, count=items), receiver)

    def publish(self, steps: Iterator[Step]) -> None:
        """Send the payloads of each step as XADDs in one pipeline. So at most one step is unanswered."""
        for step in steps:
            if isinstance(step, float):
                time.sleep(step)
                continue
            pipeline = self._client.pipeline(transaction=False)
            for payload in step:
                pipeline.xadd(STREAM, {FIELD: payload}, maxlen=self._needs.items_max, approximate=True)
            pipeline.execute()

    def subscribe(self, receiver: Receiver) -> None:
        """Read with XREAD, COUNT and BLOCK, from the beginning of the empty stream on."""
        last: bytes = b"0-0"
        receiver.ready()
        while not receiver.ended():
            answer = self._client.xread({STREAM: last}, count=self._needs.batch_items, block=WAIT_MILLIS)
            for _, entries in answer:
                _take(entries, receiver)
                last = entries[-1][0]

    def close(self) -> None:
        """End the connection."""
        self._client.close()


def _take(entries: list[tuple[bytes, dict[bytes, bytes]]], receiver: Receiver) -> None:
    for entry, fields in entries:
        millis, _, number = entry.partition(b"-")
        receiver.take(int(millis) * NANOS_PER_MS, int(number), fields[FIELD])
