"""Connects the socket of a stream, in the blocking client."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from time import monotonic

from stampede_rt.errors import StampedeError
from stampede_rt.transports.machine import enlarge_send_buffer, is_of_this_user
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import LOCAL_PREFIX, SocketRoute
from stampede_rt.transports.tcp_route import HEAD_START_S, REACH_S_MAX, SocketConnection, TcpGreeting, TcpRoute, prepare
from stampede_rt.v1 import gatekeeper_service_pb2 as pb


def connect(route: SocketRoute, ask: Callable[[], Iterable[pb.DataEndpoint]]) -> SocketConnection | None:
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
            return SocketConnection(_connected(target))
        except OSError as error:
            why = f"{target}: {error.strerror or error}"
    if route.offers_tcp:
        try:
            return _over_tcp(route)
        except OSError as error:
            why = f"tcp:{route.tcp.port}: {error.strerror or error}"
    route.failed(why)
    return None


def _connected(target: str) -> socket.socket:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.settimeout(CONNECT_S_MAX)
        enlarge_send_buffer(made)
        made.connect(target.removeprefix(LOCAL_PREFIX))
        if not is_of_this_user(made):
            raise PermissionError("the socket belongs to another user")
    except BaseException:
        made.close()
        raise
    return made


def _over_tcp(route: SocketRoute) -> SocketConnection:
    """Connect to the port if the client has reached it before. Otherwise try it in the background. Raises OSError."""
    tcp, port = route.tcp, route.tcp.port or 0
    if tcp.address is None:
        return _reached(route, port)
    try:
        return _tcp_connected(tcp, tcp.address, port, CONNECT_S_MAX)
    except OSError:
        tcp.address, tcp.is_slow = None, True
        raise


def _reached(route: SocketRoute, port: int) -> SocketConnection:
    """Begin to reach the port in the background, and wait a little for the connection. Raises OSError."""
    reaching: Future[SocketConnection] = Future()
    threading.Thread(target=_reach, args=(route, port, reaching), name="stampede connects", daemon=True).start()
    wait_s = CONNECT_S_MAX if route.is_forced else 0.0 if route.tcp.is_slow else HEAD_START_S
    try:
        return reaching.result(wait_s)
    except OSError:  # also the TimeoutError after `wait_s`
        route.tcp.is_slow = True
        raise
    finally:
        if not reaching.done():
            reaching.add_done_callback(_close_unwanted)


def _reach(route: SocketRoute, port: int, reaching: Future[SocketConnection]) -> None:
    try:
        made = _tcp_connected(route.tcp, route.tcp.host, port, REACH_S_MAX)
        route.reached(port, made.socket.getpeername()[0])
        reaching.set_result(made)
    except BaseException as error:  # noqa: BLE001  # the waiting thread raises it
        reaching.set_exception(error)


def _close_unwanted(reaching: Future[SocketConnection]) -> None:
    if reaching.exception() is None:
        reaching.result().close()


def _tcp_connected(tcp: TcpRoute, address: str, port: int, seconds: float) -> SocketConnection:
    """Connect, shake hands, and take the host's greeting. Raises OSError, also after `seconds`."""
    ends_s = monotonic() + seconds
    made = socket.create_connection((address, port), seconds)
    try:
        prepare(made)
        tls = tcp.layer()
        greeting = TcpGreeting(tls)
        made.sendall(greeting.begin())
        while not greeting.is_done:
            made.settimeout(max(0.001, ends_s - monotonic()))
            made.sendall(greeting.received(made.recv(2**14)))
    except BaseException:
        made.close()
        raise
    return SocketConnection(made, False, tls)
