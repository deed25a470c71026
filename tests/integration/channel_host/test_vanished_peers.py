"""Peers whose link is gone: no datagram comes any more, and no FIN. Streams over TCP must still end."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import grpc
import pytest

from stampede_rt.security.tls import TlsReader
from stampede_rt.security.tls_contexts import client_context
from stampede_rt.transports import (
    socket_async,
    socket_connecting_async,
    socket_connecting_sync,
    socket_sync,
)
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.socket_routes import opening_of
from stampede_rt.transports.tcp_route import TcpRoute
from stampede_rt.wire.request_pieces import SOCKET_MESSAGE_BYTES_MAX
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.namespaces import unavailable_because
from stampede_rt_runtime import roles
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.server import ServiceServer, serving
from stampede_rt_runtime.sockets import server as socket_server
from stampede_rt_runtime.sockets import tcp_socket
from stampede_rt_runtime.sockets.tcp_socket import listen_over_tcp
from stampede_rt_runtime.tls import load_tls
from tests.robustness.real_cluster.network import Network
from tests.support.raw_stream import RawStream
from tests.support.socket_port import FLOOD, HOLD, READ_LATER, SERVICE, Streams, paused_by, until

WHY_NOT = unavailable_because()
pytestmark = pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")
SILENCE_S, ALIVE_S, UNACKNOWLEDGED_MILLIS = 2.0, 0.1, 2000  # in production 7.5 s, 2.5 s and 30 s
PATIENCE_S = 60.0  # as on a busy machine
PIECES = 100  # the pieces of a message; a client could wait for each of them


class FarCaller:
    """A service of this process, and a namespace whose callers reach it as long as their link is plugged in."""

    def __init__(self, network: Network, streams: Streams, server: ServiceServer, port: int) -> None:
        self.streams, self.server, self.port = streams, server, port
        self.certificates: ClusterCertificates | None = None
        self._network = network
        [self._namespace] = network.namespaces
        self._threads = ThreadPoolExecutor(2, initializer=self._namespace.enter)

    def vanish(self) -> None:
        """Cut the link of the callers."""
        self._network.set_link(self._namespace, up=False)

    async def reach(self) -> None:
        """Wait until callers reach the service: for a moment the system may remember that the link was down."""
        while True:
            try:
                (await asyncio.wrap_future(self.start(self._connected))).close()
            except OSError:
                continue
            await until(lambda: not self.server.sockets.streams_open)
            return

    def _connected(self) -> socket.socket:
        return socket.create_connection((self._network.address, self.port), PATIENCE_S)

    def start(self, work: Callable[[], Any]) -> Future[Any]:
        """Begin the work on a thread of the namespace."""
        return self._threads.submit(work)

    @property
    def route(self) -> TcpRoute:
        """The route of the clients of the product."""
        files = None if self.certificates is None else self.certificates.issue(Role.OPERATOR, "tests")
        return TcpRoute(f"{self._network.address}:{self.port}", None if files is None else TlsReader(files).current())

    async def raw_stream(self) -> RawStream:
        """A stream of a caller that sends its own frames."""
        address, context = self._network.address, self._context()
        connected = await asyncio.wrap_future(self.start(self._connected))
        named = None if context is None else address
        made = RawStream(*await asyncio.open_connection(sock=connected, ssl=context, server_hostname=named))
        await made.take_greeting()
        return made

    def _context(self) -> ssl.SSLContext | None:
        if self.certificates is None:
            return None
        return client_context(TlsReader(self.certificates.issue(Role.OPERATOR, "tests")).current())

    def close(self) -> None:
        """Plug the link in again."""
        self._threads.shutdown(wait=False)
        self._network.set_link(self._namespace, up=True)


@pytest.fixture(scope="module")
def network() -> Iterator[Network]:
    with Network(1) as made:
        yield made


@pytest.fixture(scope="module")
def certificates(network: Network, tmp_path_factory: pytest.TempPathFactory) -> ClusterCertificates:
    folder: Path = tmp_path_factory.mktemp("certificates")
    return ClusterCertificates(folder / "all", host=network.address)


@pytest.fixture(params=["tcp", "tls"])
async def far(
    network: Network, certificates: ClusterCertificates, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[FarCaller]:
    callers = frozenset({Role.CLIENT, Role.OPERATOR})
    monkeypatch.setitem(roles._FOREIGN, f"/{SERVICE}/", callers)  # type: ignore[arg-type]
    monkeypatch.setattr(socket_server, "ALIVE_SECONDS", ALIVE_S)
    monkeypatch.setattr(tcp_socket, "UNACKNOWLEDGED_MILLIS_MAX", UNACKNOWLEDGED_MILLIS)
    for client in (socket_sync, socket_async):
        monkeypatch.setattr(client, "SILENCE_S_MAX", SILENCE_S)
    streams, is_secured = Streams(), request.param == "tls"
    tls = load_tls(certificates.issue(Role.HOST, "h1"), Role.HOST) if is_secured else None
    async with serving(streams.add_to, tls=tls) as server:
        server.sockets.register(streams.add_to)
        listening = listen_over_tcp(network.address, 0, allow_insecure_anywhere=True)
        server.sockets.listen_over_tcp(listening, None if tls is None else tls.socket_context())
        made = FarCaller(network, streams, server, listening[0].getsockname()[1])
        made.certificates = certificates if is_secured else None
        try:
            await made.reach()
            yield made
        finally:
            made.close()


@pytest.mark.parametrize("method", [HOLD, FLOOD])
async def test_a_host_ends_the_streams_of_a_caller_whose_link_is_gone(far: FarCaller, method: str) -> None:
    """One caller waits for an answer, and the other caller takes none of its many answers."""
    caller = await far.raw_stream()
    await caller.begin(method)
    await far.streams.held.acquire()
    far.vanish()
    async with asyncio.timeout(PATIENCE_S):
        await far.streams.cancelled.acquire()
    await until(lambda: not far.server.sockets.streams_open)
    caller.writer.transport.abort()


def waits_for_an_answer(route: TcpRoute, number: int) -> None:
    connected = socket_connecting_sync._tcp_connected(route, route.host, number, PATIENCE_S)
    call = socket_sync.SocketCall(connected.socket, method_of(HOLD), opening(HOLD), in_turn=False, tls=connected.tls)
    next(call)


def sends_more_than_the_host_takes(route: TcpRoute, number: int) -> None:
    connected = socket_connecting_sync._tcp_connected(route, route.host, number, PATIENCE_S)
    method = method_of(READ_LATER)
    call = socket_sync.SocketCall(connected.socket, method, opening(READ_LATER), in_turn=True, tls=connected.tls)
    call.send(bytes(PIECES * SOCKET_MESSAGE_BYTES_MAX))
    next(call)


def awaits_an_answer(route: TcpRoute, number: int) -> None:
    async def wait() -> None:
        connected = await socket_connecting_async._tcp_connected(route, route.host, number)
        call = await socket_async.SocketCall.open(connected.socket, method_of(HOLD), opening(HOLD), connected.tls)
        await anext(call)

    asyncio.run(wait())


def awaits_room_at_the_host(route: TcpRoute, number: int) -> None:
    async def send() -> None:
        connected = await socket_connecting_async._tcp_connected(route, route.host, number)
        opened = opening(READ_LATER)
        call = await socket_async.SocketCall.open(connected.socket, method_of(READ_LATER), opened, connected.tls)
        while True:
            await call.write(bytes(2**17))

    asyncio.run(send())


def method_of(path: str) -> BidiMethod:
    return BidiMethod(path, None, None, lambda: None)


def opening(path: str) -> bytes:
    return opening_of(path, (), b"")


@pytest.mark.parametrize(
    "client",
    [waits_for_an_answer, awaits_an_answer, sends_more_than_the_host_takes, awaits_room_at_the_host],
)
async def test_a_client_ends_a_stream_to_a_host_whose_link_is_gone(
    far: FarCaller, client: Callable[[TcpRoute, int], None]
) -> None:
    running = asyncio.wrap_future(far.start(partial(client, far.route, far.port)))
    held = asyncio.ensure_future(far.streams.held.acquire())
    await asyncio.wait({held, running}, return_when=asyncio.FIRST_COMPLETED)
    assert held.done(), running.exception()
    if client in (sends_more_than_the_host_takes, awaits_room_at_the_host):
        await paused_by(far.server)
    far.vanish()
    async with asyncio.timeout(PATIENCE_S):
        with pytest.raises(grpc.RpcError) as ended:
            await running
    assert ended.value.code() == grpc.StatusCode.UNAVAILABLE
    assert "no sign of life" in ended.value.details()
