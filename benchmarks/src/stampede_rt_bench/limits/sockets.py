"""Raw sockets, Unix and TCP. Each frame is its length and its bytes. No client and server in Python can be faster."""

from __future__ import annotations

import select
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from stampede_rt_bench.limits.framing import LENGTH, ONE_READER, REQUEST
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds
from stampede_rt_bench.workloads.processes import server

LOOK_SECONDS = 0.1


@dataclass(frozen=True)
class RawSockets:
    """A relay of frames in a separate process, with one thread for each connection."""

    family: Literal["unix", "tcp"]

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return the kinds of workload that this system cannot run: frames, because it serves one reader only."""
        return {"frames": ONE_READER}

    @property
    def name(self) -> str:
        """The name of the system in tables."""
        return {"unix": "bare Unix socket", "tcp": "bare TCP socket"}[self.family]

    def unavailable_because(self) -> str | None:
        """Return None, because Python has both kinds of sockets."""
        return None

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run the relay in a new process for the duration of the context."""
        with tempfile.TemporaryDirectory(prefix="stampede-bench-") as folder:
            ready = Path(folder, "address")
            command = [sys.executable, "-P", "-m", "stampede_rt_bench.limits.socket_server", self.family, str(ready)]
            with server(command, Path(folder, "log"), ready.exists) as pid:
                yield RunningServer(address=ready.read_text(), pids=[pid])

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> SocketClient:
        """Return a client, which opens one connection for each kind of workload."""
        return SocketClient(self.family, served.address, needs)


class SocketClient:
    """Blocking sockets, one for each kind of workload."""

    def __init__(self, family: str, address: str, needs: WorkloadNeeds) -> None:
        self._family, self._address, self._needs = family, address, needs
        self._sockets: list[socket.socket] = []

    def put(self, payloads: Iterator[bytes]) -> None:
        """Send each payload as a frame, and wait for an answer of 24 bytes."""
        connection = self._open(b"A")
        for payload in payloads:
            connection.sendall(LENGTH.pack(len(payload)) + payload)
            receive(connection)

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Send a small frame, and wait for one item."""
        self.interval(turns, receiver)

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Send a small frame, and wait for the bytes of all items in one frame."""
        connection = self._open(b"F")
        for items in turns:
            request = REQUEST.pack(items, self._needs.item_bytes)
            connection.sendall(LENGTH.pack(len(request)) + request)
            receiver.take_block(items, receive(connection))

    def publish(self, steps: Iterator[Step]) -> None:
        """Send the payloads of each step, joined, as one frame. The kernel's buffers bound the bytes under way."""
        connection = self._open(b"I")
        for step in steps:
            if isinstance(step, float):
                time.sleep(step)
            else:
                connection.sendall(b"".join([LENGTH.pack(sum(map(len, step))), *step]))

    def subscribe(self, receiver: Receiver) -> None:
        """Take whole frames until the run ends."""
        connection = self._open(b"O")
        receive(connection)
        receiver.ready()
        while not receiver.ended():
            if select.select([connection], [], [], LOOK_SECONDS)[0]:
                frame = receive(connection)
                receiver.take_block(len(frame) // self._needs.item_bytes, frame)

    def close(self) -> None:
        """End the connections."""
        for connection in self._sockets:
            connection.close()

    def _open(self, kind: bytes) -> socket.socket:
        if self._family == "unix":
            connection = socket.socket(socket.AF_UNIX)
            connection.connect(self._address)
        else:
            host, _, port = self._address.rpartition(":")
            connection = socket.create_connection((host, int(port)))
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._sockets.append(connection)
        connection.sendall(kind)
        return connection


def receive(connection: socket.socket) -> bytes | bytearray:
    """Return one frame. Raises ConnectionError at the end of the stream."""
    (length,) = LENGTH.unpack(_exactly(connection, LENGTH.size))
    return _exactly(connection, length)


def _exactly(connection: socket.socket, length: int) -> bytes | bytearray:
    first = connection.recv(length)
    if len(first) == length:
        return first
    frame = bytearray(length)
    frame[: len(first)] = first
    view, place = memoryview(frame), len(first)
    while place < length:
        count = connection.recv_into(view[place:])
        if not count:
            raise ConnectionError("the other side closed the connection")
        place += count
    return frame
