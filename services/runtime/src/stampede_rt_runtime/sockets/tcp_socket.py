"""The TCP port of a host for streams over sockets."""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence

from stampede_rt.transports.tcp_route import prepare
from stampede_rt_runtime.listen import CannotListen, check_listen
from stampede_rt_runtime.sockets.stream_socket import STALL_SECONDS_MAX
from stampede_rt_runtime.sockets.unix_socket import BACKLOG
from stampede_rt_runtime.values import Address

UNACKNOWLEDGED_MILLIS_MAX = int(STALL_SECONDS_MAX * 1000)
"""After this time without an acknowledgement of sent bytes, the system ends a connection. The peer has vanished, or it
takes no bytes."""
_NOT_HERE = (errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL)


def listen_over_tcp(host: str, port: int, *, allow_insecure_anywhere: bool) -> list[socket.socket]:
    """Listening sockets at all addresses of `host`, with one port; 0: any free one. Raises CannotListen, NotAllowed."""
    check_listen(str(Address(host, port)), allow_insecure_anywhere=allow_insecure_anywhere, flag="--data-port")
    made: list[socket.socket] = []
    try:
        for family, _, _, _, address in socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        ):
            own = port or (made[0].getsockname()[1] if made else 0)
            if (one := _listening(family, (address[0], own, *address[2:]))) is not None:
                made.append(one)
    except OSError as error:
        for one in made:
            one.close()
        raise CannotListen(f"the service cannot listen at {Address(host, port)}: {error.strerror or error}") from error
    if not made:
        raise CannotListen(f"{host} is not an address of this machine; give --listen one of its own")
    return made


def _listening(family: int, address: Sequence[object]) -> socket.socket | None:
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        prepare(made)  # accepted connections inherit these options
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MILLIS_MAX)
        made.bind(tuple(address))
        made.listen(BACKLOG)
        made.setblocking(False)
    except OSError as error:
        made.close()
        if family == socket.AF_INET6 and error.errno in _NOT_HERE:
            return None  # a machine without IPv6 whose names still have IPv6 addresses
        raise
    return made


def peer_of(accepted: socket.socket) -> str:
    """The other side, as gRPC names it. Raises OSError if it has gone."""
    host, port = accepted.getpeername()[:2]
    host = str(host).removeprefix("::ffff:")
    return f"ipv6:%5B{host}%5D:{port}" if ":" in host else f"ipv4:{host}:{port}"
