"""The relay behind the raw sockets: `python -m stampede_rt_bench.limits.socket_server unix|tcp FILE`.

It writes its address to FILE. The first byte of a connection gives its kind. A: the relay acknowledges each frame. F:
it answers each request with bytes. I: it passes all bytes on to the connections of kind O. The kernel's buffers are
the only queues.
"""

from __future__ import annotations

import socket
import sys
import threading
from contextlib import suppress
from pathlib import Path

from stampede_rt_bench.limits.framing import ACK, LENGTH, REQUEST
from stampede_rt_bench.limits.sockets import receive

CHUNK_BYTES = 1 << 20


class SocketRelay:
    """Serves connections, each in a thread."""

    def __init__(self) -> None:
        self._outs: list[socket.socket] = []

    def serve(self, connection: socket.socket) -> None:
        """Serve one connection until the other side closes it."""
        with suppress(ConnectionError), connection:
            kind = connection.recv(1)
            {b"A": self._acknowledge, b"F": self._answer, b"I": self._send_on, b"O": self._keep}[kind](connection)

    def _acknowledge(self, connection: socket.socket) -> None:
        answer = LENGTH.pack(len(ACK)) + ACK
        while True:
            receive(connection)
            connection.sendall(answer)

    def _answer(self, connection: socket.socket) -> None:
        answers: dict[bytes, bytes] = {}
        while True:
            request = bytes(receive(connection))
            if request not in answers:
                items, size = REQUEST.unpack(request)
                answers = {request: LENGTH.pack(items * size) + bytes(items * size)}
            connection.sendall(answers[request])

    def _send_on(self, connection: socket.socket) -> None:
        chunk = memoryview(bytearray(CHUNK_BYTES))
        while count := connection.recv_into(chunk):
            for out in self._outs:
                out.sendall(chunk[:count])

    def _keep(self, connection: socket.socket) -> None:
        connection.sendall(LENGTH.pack(1) + b"O")
        self._outs.append(connection)
        connection.recv(1)  # returns when the reader closes the connection, because a reader sends nothing
        self._outs.remove(connection)


def main() -> None:
    """Serve until this process is killed."""
    family, file = sys.argv[1:]
    path = Path(file)
    if family == "unix":
        listener, address = socket.socket(socket.AF_UNIX), str(path.with_name("socket"))
        listener.bind(address)
        listener.listen()
    else:
        listener = socket.create_server(("127.0.0.1", 0))
        address = f"127.0.0.1:{listener.getsockname()[1]}"
    path.with_suffix(".new").write_text(address)
    path.with_suffix(".new").rename(path)
    relay = SocketRelay()
    while True:
        connection, _ = listener.accept()
        if family == "tcp":
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        threading.Thread(target=relay.serve, args=(connection,), daemon=True).start()


if __name__ == "__main__":
    main()
