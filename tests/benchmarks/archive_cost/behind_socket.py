"""A plain writer whose bytes come from another process through a socket, as the bytes that a host writes do."""

from __future__ import annotations

import multiprocessing
import os
import socket
from pathlib import Path

from tests.benchmarks.archive_cost.figures import seconds_of


def seconds_behind_socket(path: Path, part: bytes, parts: int, sync_bytes: int) -> float:
    """The time in which another process receives parts and appends them to a file, with an fsync after `sync_bytes`."""
    near, far = socket.socketpair()
    arguments = (far, path, len(part), parts, sync_bytes)
    process = multiprocessing.get_context("spawn").Process(target=_receive, args=arguments, daemon=True)
    process.start()
    far.close()
    with near:
        assert near.recv(1), "the process is ready"

        def send() -> None:
            for _ in range(parts):
                near.sendall(part)
            assert near.recv(1), "everything is on the disk"

        taken = seconds_of(send)
    process.join()
    path.unlink()
    return taken


def _receive(connection: socket.socket, path: Path, part_bytes: int, parts: int, sync_bytes: int) -> None:
    waiting, room = 0, memoryview(bytearray(part_bytes))
    with connection, path.open("wb", buffering=0) as file:
        connection.sendall(b"r")
        for _ in range(parts):
            connection.recv_into(room, part_bytes, socket.MSG_WAITALL)
            waiting += file.write(room)
            if waiting >= sync_bytes:
                os.fsync(file)
                waiting = 0
        os.fsync(file)
        connection.sendall(b"d")
