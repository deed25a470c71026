"""Connects the socket of a stream, in the blocking client."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable

from stampede_rt.errors import StampedeError
from stampede_rt.transports.machine import is_of_this_user
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import LOCAL_PREFIX, SocketRoute
from stampede_rt.v1 import gatekeeper_service_pb2 as pb


def connect(route: SocketRoute, ask: Callable[[], Iterable[pb.DataEndpoint]]) -> socket.socket | None:
    """Return a new connection to the host; None: use gRPC. `ask` asks the gatekeeper for the host's sockets.

    Blocks for at most CONNECT_S_MAX, and once more if it asks. Raises Unavailable if the program has chosen sockets.
    """
    if not route.may_lead:
        return None
    why = ""
    if route.must_ask:
        try:
            route.learn(ask())
        except StampedeError as error:
            why = str(error)
    for target in route.targets:
        try:
            return _connected(target)
        except OSError as error:
            why = f"{target}: {error.strerror or error}"
    route.failed(why)
    return None


def _connected(target: str) -> socket.socket:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.settimeout(CONNECT_S_MAX)
        made.connect(target.removeprefix(LOCAL_PREFIX))
        if not is_of_this_user(made):
            raise PermissionError("the socket is one of another user")
    except BaseException:
        made.close()
        raise
    return made
