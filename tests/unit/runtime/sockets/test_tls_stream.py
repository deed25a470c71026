"""Streams over TCP with certificates: both clients of the product, and callers that the port refuses."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import socket
import ssl
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from stampede_rt.security.tls import TlsReader
from stampede_rt.security.tls_contexts import client_context
from stampede_rt.transports import socket_async, socket_connecting_async, socket_connecting_sync, socket_sync
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.socket_routes import opening_of
from stampede_rt.transports.tcp_route import TcpRoute
from stampede_rt.transports.tls_layer import TlsLayer
from stampede_rt.wire.stream_frames import FrameKind
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.sockets import server, tls_stream
from stampede_rt_runtime.sockets.tls_stream import TlsStream
from tests.support.raw_stream import SECURED, raw_stream
from tests.support.socket_port import ECHO, HOLD, TLS, Open, Port, certificates, port_fixture, until

port = port_fixture(TLS)
ECHOES = BidiMethod(ECHO, None, None, lambda: None)
MESSAGES = [b"x" * 10, bytes(range(256)) * 4000, b"", b"y" * 70_000]


def route_to(one: Port, host: str = "localhost") -> tuple[TcpRoute, int]:
    files = certificates().issue(Role.OPERATOR, "tests")
    number = int(one.target.rpartition(":")[2])
    return TcpRoute(f"{host}:{number}", TlsReader(files).current()), number


async def test_the_blocking_client_exchanges_messages_of_all_lengths(port: Open) -> None:
    def exchange(route: TcpRoute, number: int) -> list[bytes]:
        connected = socket_connecting_sync._tcp_connected(route, route.host, number, 20)
        opening = opening_of(ECHO, (), b"")
        call = socket_sync.SocketCall(connected.socket, ECHOES, opening, in_turn=False, tls=connected.tls)
        for message in MESSAGES:
            call.send(message)
        got = [next(call) for _ in MESSAGES]
        call.cancel()
        return got

    async with port() as one:
        assert await asyncio.to_thread(exchange, *route_to(one)) == MESSAGES


async def test_the_client_on_asyncio_exchanges_messages_of_all_lengths(port: Open) -> None:
    async with port() as one:
        route, number = route_to(one)
        connected = await socket_connecting_async._tcp_connected(route, route.host, number)
        opening = opening_of(ECHO, (), b"")
        call = await socket_async.SocketCall.open(connected.socket, ECHOES, opening, connected.tls)
        for message in MESSAGES:
            await call.write(message)
        assert [await anext(call) for _ in MESSAGES] == MESSAGES
        call.cancel()


async def test_a_client_sends_nothing_to_a_host_whose_certificate_names_another_address(port: Open) -> None:
    async with port() as one:
        route, number = route_to(one, host="rig.example")
        with pytest.raises(ssl.SSLCertVerificationError, match=r"rig\.example"):
            await asyncio.to_thread(socket_connecting_sync._tcp_connected, route, "127.0.0.1", number, 20)
        await until(lambda: not one.server.sockets._streams)


def without_certificate() -> ssl.SSLContext:
    return ssl.create_default_context(cafile=certificates().ca)


def of_another_authority(folder: Path) -> ssl.SSLContext:
    other = ClusterCertificates(folder / "other")
    made = client_context(TlsReader(other.issue(Role.OPERATOR, "tests")).current())
    made.load_verify_locations(cafile=certificates().ca)
    return made


def of_an_old_version() -> ssl.SSLContext:
    made = client_context(TlsReader(certificates().issue(Role.OPERATOR, "tests")).current())
    made.minimum_version = made.maximum_version = ssl.TLSVersion.TLSv1_2
    return made


@pytest.mark.parametrize("fault", ["no certificate", "another authority", "TLS 1.2"])
async def test_the_port_sends_no_greeting_to_a_caller_without_a_certificate_of_the_cluster(
    port: Open, tmp_path: Path, fault: str
) -> None:
    contexts = {
        "no certificate": without_certificate,
        "another authority": lambda: of_another_authority(tmp_path),
        "TLS 1.2": of_an_old_version,
    }
    async with port() as one:
        SECURED[one.target] = contexts[fault]()
        with contextlib.suppress(ssl.SSLError, ConnectionError):
            async with raw_stream(one.target) as stream:
                assert not stream.is_greeted
        await until(lambda: not one.server.sockets._streams)


@pytest.mark.parametrize("sent", [b"", b"\x16", b"GET / HTTP/1.1\r\n\r\n", b"\x00" * 1000])
async def test_a_caller_that_does_not_finish_the_handshake_is_disconnected(port: Open, sent: bytes) -> None:
    async with port(limits=Limits(handshake_millis_max=100)) as one:
        reader, writer = await asyncio.open_connection("localhost", int(one.target.rpartition(":")[2]))
        writer.write(sent)
        async with asyncio.timeout(20):
            while await reader.read(2**16):  # an alert, maybe
                pass
        writer.close()
        await until(lambda: not one.server.sockets._streams)


async def ended_stream(one: Port) -> None:
    async with raw_stream(one.target) as stream:
        await stream.begin(ECHO)
        await stream.send(FrameKind.MESSAGE, b"hello")
        assert await stream.frame() == (FrameKind.MESSAGE, b"hello")


async def ended_handshake(one: Port) -> None:
    _, writer = await asyncio.open_connection("localhost", int(one.target.rpartition(":")[2]))
    writer.write(b"\x16\x03\x01")
    await until(lambda: one.server.sockets.streams_open == 1)
    writer.transport.abort()


async def malformed_handshake(one: Port) -> None:
    reader, writer = await asyncio.open_connection("localhost", int(one.target.rpartition(":")[2]))
    writer.write(b"GET / HTTP/1.1\r\n\r\n")
    async with asyncio.timeout(20):
        while await reader.read(2**16):  # an alert
            pass
    writer.close()


@pytest.mark.parametrize("connect", [ended_stream, ended_handshake, malformed_handshake])
async def test_the_tls_of_an_ended_connection_is_freed_without_the_garbage_collector(
    port: Open, connect: Callable[[Port], Awaitable[None]]
) -> None:
    """In an earlier version, each ended connection kept 30 KB until a collection of all garbage.

    Any caller could open thousands of connections.
    """

    def kept() -> int:
        return sum(isinstance(one, TlsStream | TlsLayer) for one in gc.get_objects())

    async with port() as one:
        gc.collect()
        before = kept()
        gc.disable()
        try:
            for _ in range(3):
                await connect(one)
                await until(lambda: not one.server.sockets._streams)
            await until(lambda: kept() == before)
        finally:
            gc.enable()


async def test_an_unfinished_handshake_does_not_stop_the_signs_of_life_on_other_streams(
    port: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, one connection without a handshake ended all signs of life of the host."""
    monkeypatch.setattr(server, "ALIVE_SECONDS", 0.01)
    async with port() as one:
        _, unfinished = await asyncio.open_connection("localhost", int(one.target.rpartition(":")[2]))
        await until(lambda: one.server.sockets.streams_open == 1)
        async with raw_stream(one.target) as stream:
            await stream.begin(HOLD)
            for _ in range(3):
                assert await stream.frame() == (FrameKind.ALIVE, b"")
        unfinished.transport.abort()


async def test_the_loop_takes_a_few_steps_of_handshakes_and_then_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    steps, taken = tls_stream.HandshakeSteps(), list[int]()
    monkeypatch.setattr(tls_stream, "PAUSE_SECONDS", 3600.0)
    for number in range(10):
        steps.add("10.0.0.3", lambda number=number: taken.append(number))  # type: ignore[misc]
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert taken == list(range(tls_stream.STEPS_PER_TURN))


async def test_many_handshakes_of_one_machine_delay_the_handshake_of_another_by_one_step() -> None:
    steps, taken = tls_stream.HandshakeSteps(), list[str]()
    for number in range(10):
        steps.add("10.0.0.3", lambda number=number: taken.append(f"flood {number}"))  # type: ignore[misc]
    for machine in ("10.0.0.4", "10.0.0.5"):
        steps.add(machine, lambda machine=machine: taken.append(machine))  # type: ignore[misc]
    await until(lambda: len(taken) == 12)
    assert taken[:4] == ["flood 0", "10.0.0.4", "10.0.0.5", "flood 1"]
    assert taken[4:] == [f"flood {number}" for number in range(2, 10)]


async def test_the_port_uses_renewed_certificates(port: Open) -> None:
    async with port() as one:
        tls = one.server._tls
        assert tls is not None
        newest = tls.socket_context()
        before = newest()
        assert newest() is before
        tls.reader._material = TlsReader(tls.reader.files).current()
        assert newest() is not before


async def test_a_socket_has_the_options_of_tcp(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(ECHO)
        [made] = one.server.sockets._streams
        assert made.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert made.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
