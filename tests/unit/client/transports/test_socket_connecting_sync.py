"""Both clients reach the second TCP port of a host, and never wait long for it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from functools import cache

import pytest

from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import Unavailable
from stampede_rt.transports import socket_connecting_async, socket_connecting_sync
from stampede_rt.transports.socket_routes import SocketRoute
from stampede_rt.transports.tcp_route import GREETING, SocketConnection
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.wire.stream_frames import FrameKind, frame_of
from tests.support.waiting import wait_until

Connect = Callable[[SocketRoute, int], SocketConnection | None]


@cache
def endpoints(port: int) -> tuple[pb.DataEndpoint, ...]:
    return (pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=f"tcp:{port}"),)


def over_threads(route: SocketRoute, port: int) -> SocketConnection | None:
    return socket_connecting_sync.connect(route, lambda: endpoints(port))


def on_a_loop(route: SocketRoute, port: int) -> SocketConnection | None:
    async def connect() -> SocketConnection | None:
        async def ask() -> tuple[pb.DataEndpoint, ...]:
            return endpoints(port)

        return await socket_connecting_async.connect(route, ask)

    return asyncio.run(connect())


@pytest.fixture(params=[over_threads, on_a_loop])
def connect(request: pytest.FixtureRequest) -> Connect:
    return request.param  # type: ignore[no-any-return]


@pytest.fixture
def listening() -> Iterator[socket.socket]:
    """A port that accepts connections. The test sends the greeting of the host."""
    with socket.create_server(("127.0.0.1", 0)) as made:
        made.settimeout(20)
        yield made


def port_of(listening: socket.socket) -> int:
    return int(listening.getsockname()[1])


def best() -> SocketRoute:
    return SocketRoute("127.0.0.1:7590", Transport.BEST)


def greet(listening: socket.socket, answer: bytes = GREETING) -> socket.socket:
    accepted, _ = listening.accept()
    accepted.sendall(answer)
    return accepted


async def test_a_host_that_greets_gets_the_stream(connect: Connect, listening: socket.socket) -> None:
    greeting = asyncio.ensure_future(asyncio.to_thread(greet, listening))
    route = SocketRoute("127.0.0.1:7590", Transport.TCP)
    connected = await asyncio.to_thread(connect, route, port_of(listening))
    assert connected is not None
    assert not connected.is_local
    with connected.socket, await greeting:
        assert route.tcp.address == "127.0.0.1"
        assert connected.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        timeout_millis = connected.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
        assert timeout_millis == 0, "a limit would end the stream of a put that waits for room, although the host lives"


async def test_a_port_without_a_greeting_delays_no_stream_and_is_used_after_it_greets(
    listening: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_connecting_sync, "HEAD_START_S", 0.01)
    route, port = best(), port_of(listening)
    assert over_threads(route, port) is None
    assert not route.may_lead  # the next streams do not even try TCP
    with await asyncio.to_thread(greet, listening):
        await asyncio.to_thread(wait_until, lambda: route.tcp.address, "the port is reached in the background")
    assert route.late_arrivals == 1  # streams over TCP will replace idle streams over gRPC
    assert route.offers_tcp
    greeting = asyncio.ensure_future(asyncio.to_thread(greet, listening))
    connected = await asyncio.to_thread(over_threads, route, port)
    assert connected is not None
    with connected.socket, await greeting:
        pass


async def test_an_asyncio_client_uses_a_port_after_the_port_has_greeted(
    listening: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_connecting_async, "HEAD_START_S", 0.01)
    route = best()
    route.learn(endpoints(port_of(listening)))

    async def ask() -> tuple[pb.DataEndpoint, ...]:
        return endpoints(port_of(listening))

    assert await socket_connecting_async.connect(route, ask) is None
    with await asyncio.to_thread(greet, listening):
        await asyncio.wait_for(asyncio.wait({route.tcp.reaching}), 20)
    assert route.late_arrivals == 1
    greeting = asyncio.ensure_future(asyncio.to_thread(greet, listening))
    connected = await socket_connecting_async.connect(route, ask)
    assert connected is not None
    with connected.socket, await greeting:
        pass


@pytest.mark.parametrize("answer", [frame_of(FrameKind.STATUS, b"x"), b"HTTP/1.1 400 Bad Request\r\n\r\n", b""])
async def test_a_port_with_another_answer_gets_no_credential_and_the_stream_uses_grpc(
    connect: Connect, listening: socket.socket, answer: bytes
) -> None:
    def other() -> bytes:
        with greet(listening, answer) as accepted:
            if not answer:
                accepted.shutdown(socket.SHUT_WR)
            accepted.settimeout(20)
            return accepted.recv(100)

    served = asyncio.ensure_future(asyncio.to_thread(other))
    assert await asyncio.to_thread(connect, best(), port_of(listening)) is None
    assert await served == b""


def test_a_stream_uses_grpc_if_the_port_is_closed(connect: Connect, listening: socket.socket) -> None:
    port = port_of(listening)
    listening.close()
    route = best()
    assert connect(route, port) is None
    assert not route.may_lead
    with pytest.raises(Unavailable, match=f"tcp:{port}: "):
        connect(SocketRoute("127.0.0.1:7590", Transport.TCP), port)


@pytest.mark.parametrize("false", ["tcp:0", "tcp:65536", "tcp:-1", "tcp:10.0.0.9:80", "tcp:80\n", "tcp:", "80"])
def test_a_false_host_leads_no_client_to_another_machine(false: str) -> None:
    route = best()
    route.learn([pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=false)])
    assert not route.offers_tcp
