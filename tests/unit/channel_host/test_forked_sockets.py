"""A forked child closes its copies of a server's sockets, and none of the program's own."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from pathlib import Path

from stampede_rt_channel_host.forked_sockets import close_copies


def test_a_forked_child_closes_only_the_sockets_of_the_server_and_keeps_their_descriptors_reserved(
    tmp_path: Path,
) -> None:
    path = str(tmp_path / "at")
    with ExitStack() as opened:
        server = opened.enter_context(socket.create_server(("127.0.0.1", 0)))
        port = server.getsockname()[1]
        caller = opened.enter_context(socket.create_connection(("127.0.0.1", port)))
        accepted = opened.enter_context(server.accept()[0])
        local = opened.enter_context(socket.socket(socket.AF_UNIX))
        local.bind(path)
        local.listen()
        elsewhere = opened.enter_context(socket.create_server(("127.0.0.2", port)))
        datagrams = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        datagrams.bind(("127.0.0.1", port))
        numbers = [one.fileno() for one in (server, accepted, local)]
        close_copies(f"localhost:{port}", path)
        assert caller.recv(1) == b"", "the server's end is closed"
        assert elsewhere.getsockname() == ("127.0.0.2", port)
        assert datagrams.getsockname() == ("127.0.0.1", port)
        with socket.socket() as another:
            assert another.fileno() not in numbers, "the owner of a closed socket may close its descriptor once more"


def test_a_child_closes_nothing_if_the_server_does_not_listen_yet() -> None:
    left, right = socket.socketpair()
    with left, right:
        close_copies("", "")
        left.sendall(b"x")
        assert right.recv(1) == b"x"
