"""Connects the socket of a stream, in the client on asyncio."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable, Iterable

from stampede_rt.errors import StampedeError
from stampede_rt.transports.machine import enlarge_send_buffer, is_of_this_user
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import LOCAL_PREFIX, SocketRoute
from stampede_rt.transports.tcp_route import HEAD_START_S, REACH_S_MAX, SocketConnection, TcpGreeting, TcpRoute, prepare
from stampede_rt.v1 import gatekeeper_service_pb2 as pb

_reaching: set[asyncio.Future[SocketConnection]] = set()  # keeps the tasks until they are done


async def connect(
    route: SocketRoute, ask: Callable[[], Awaitable[Iterable[pb.DataEndpoint]]]
) -> SocketConnection | None:
    """Return a new connection to the host; None: use gRPC. `ask` asks the gatekeeper for the host's sockets.

    Waits for at most CONNECT_S_MAX, and once more if it asks. Raises Unavailable if the program has chosen sockets.
    """
    if not route.may_lead:
        return None
    why = ""
    if route.must_ask:
        try:
            route.learn(await ask())
        except StampedeError as error:
            why = str(error)
    for target in route.targets:
        try:
            async with asyncio.timeout(CONNECT_S_MAX):
                return SocketConnection(await _connected(target))
        except (OSError, TimeoutError) as error:
            why = f"{target}: {error or 'no answer'}"
    if route.offers_tcp:
        try:
            return await _over_tcp(route)
        except OSError as error:
            why = f"tcp:{route.tcp.port}: {error.strerror or error or 'no answer'}"
    route.failed(why)
    return None


async def _connected(target: str) -> socket.socket:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.setblocking(False)
        enlarge_send_buffer(made)
        await asyncio.get_running_loop().sock_connect(made, target.removeprefix(LOCAL_PREFIX))
        if not is_of_this_user(made):
            raise PermissionError("the socket belongs to another user")
    except BaseException:
        made.close()
        raise
    return made


async def _over_tcp(route: SocketRoute) -> SocketConnection:
    """Connect to the port if the client has reached it before. Otherwise try it in the background. Raises OSError."""
    tcp, port = route.tcp, route.tcp.port or 0
    if tcp.address is None:
        return await _reached(route, port)
    try:
        async with asyncio.timeout(CONNECT_S_MAX):
            return await _tcp_connected(tcp, tcp.address, port)
    except OSError:
        tcp.address, tcp.is_slow = None, True
        raise


async def _reached(route: SocketRoute, port: int) -> SocketConnection:
    """Begin to reach the port in the background, and wait a little for the connection. Raises OSError."""
    reaching = asyncio.ensure_future(_reach(route, port))
    _reaching.add(reaching)
    reaching.add_done_callback(_reaching.discard)
    route.tcp.reaching = reaching
    wait_s = CONNECT_S_MAX if route.is_forced else 0.0 if route.tcp.is_slow else route.tcp.head_start_s or HEAD_START_S
    try:
        async with asyncio.timeout(wait_s):
            return await asyncio.shield(reaching)
    except BaseException as error:
        reaching.add_done_callback(_close_unwanted)  # it may be done by now, too
        route.tcp.is_slow = route.tcp.is_slow or isinstance(error, OSError)
        raise


async def _reach(route: SocketRoute, port: int) -> SocketConnection:
    async with asyncio.timeout(REACH_S_MAX):
        made = await _tcp_connected(route.tcp, route.tcp.host, port)
    route.reached(port, made.socket.getpeername()[0])
    return made


def _close_unwanted(reaching: asyncio.Future[SocketConnection]) -> None:
    if not reaching.cancelled() and reaching.exception() is None:
        reaching.result().close()


async def _tcp_connected(tcp: TcpRoute, host: str, port: int) -> SocketConnection:
    """Connect, shake hands, and take the host's greeting. Raises OSError."""
    loop = asyncio.get_running_loop()
    made = await _at_one_of(await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM))
    try:
        prepare(made)
        tls = tcp.layer()
        greeting = TcpGreeting(tls)
        await loop.sock_sendall(made, greeting.begin())
        while not greeting.is_done:
            await loop.sock_sendall(made, greeting.received(await loop.sock_recv(made, 2**14)))
    except BaseException:
        made.close()
        raise
    return SocketConnection(made, False, tls)


async def _at_one_of(addresses: Iterable[tuple[int, int, int, str, tuple]]) -> socket.socket:  # type: ignore[type-arg]
    """Connect to the first address that takes the connection. Raises the last OSError."""
    failure = OSError("the name has no address")
    for family, kind, protocol, _, address in addresses:
        made = socket.socket(family, kind, protocol)
        try:
            made.setblocking(False)
            await asyncio.get_running_loop().sock_connect(made, address)
        except OSError as error:
            made.close()
            failure = error
        except BaseException:
            made.close()
            raise
        else:
            return made
    raise failure
