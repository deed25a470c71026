"""The streams that a service opens at a host: over the sockets that the host offers, or else over gRPC."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import grpc
import pytest

from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2_grpc
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.server import serving
from stampede_rt_runtime.sockets.dialing import ANSWER_SECONDS_MAX, ANSWERS_MAX, KnownEndpoints
from stampede_rt_runtime.tls import load_tls
from tests.support.socket_port import (
    ECHO,
    HOLD,
    REFUSE,
    TLS,
    Open,
    Port,
    Streams,
    certificates,
    port_fixture,
    until,
)

port = port_fixture()
SECRET = Secret(text="the secret", path=Path("secret"))


class Gatekeeper(gatekeeper_service_pb2_grpc.GatekeeperServiceServicer):
    """A host that offers the socket at `target`, and serves the same methods over gRPC."""

    def __init__(self, target: str) -> None:
        self._target = target
        self.streams = Streams()
        self.calls = 0

    def add_to(self, server: Any) -> None:
        gatekeeper_service_pb2_grpc.add_GatekeeperServiceServicer_to_server(self, server)
        self.streams.add_to(server)

    async def ListDataEndpoints(self, request: Any, context: Any) -> pb.ListDataEndpointsResponse:  # noqa: N802
        self.calls += 1
        offered = pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=self._target, ticket=b"t" * 32)
        return pb.ListDataEndpointsResponse(endpoints=[offered])


class Rig:
    """A connection to a host. `at_socket`: the methods at its socket, and `over_grpc`: the same over gRPC.

    `known`: the answers of the host to this connection and to others. `dial_again` opens another connection.
    """

    address: str
    known: KnownEndpoints
    dial_again: Callable[[], AbstractAsyncContextManager[grpc.aio.Channel]]

    def __init__(self, channel: grpc.aio.Channel, one: Port, gatekeeper: Gatekeeper) -> None:
        self.channel, self.at_socket, self.over_grpc = channel, one.streams, gatekeeper.streams
        self.gatekeeper = gatekeeper
        self._server = one.server

    @property
    def sockets(self) -> int:
        """The number of open sockets."""
        return self._server.sockets.streams_open

    def begin(self, method: str) -> Any:
        return self.channel.stream_stream(method)()  # type: ignore[call-arg]


Opened = Callable[..., AbstractAsyncContextManager[Rig]]


@pytest.fixture
def rig(port: Open, request: pytest.FixtureRequest) -> Opened:
    """Open a rig. `offers`: the target that the host offers; "": the target of its socket."""
    is_secured = request.node.callspec.params["port"] == TLS

    @asynccontextmanager
    async def opened(transport: Transport = Transport.BEST, offers: str = "") -> AsyncIterator[Rig]:
        async with port(secret=None if is_secured else SECRET) as one, AsyncExitStack() as stack:
            gatekeeper = Gatekeeper(offers or one.target.replace("tcp:localhost", "tcp"))
            own = load_tls(certificates().issue(Role.HOST, "h2"), Role.HOST) if is_secured else None
            secret = None if is_secured else SECRET
            server = await stack.enter_async_context(serving(gatekeeper.add_to, secret=secret, tls=own))
            reader = TlsReader(certificates().issue(Role.OPERATOR, "tests")) if is_secured else None
            known = KnownEndpoints(lambda: 0.0)
            dial_again = partial(dial, server.address, secret=secret, tls=reader, transport=transport, known=known)
            made = Rig(await stack.enter_async_context(dial_again()), one, gatekeeper)
            made.known, made.dial_again, made.address = known, dial_again, server.address
            yield made

    return opened


async def echo(call: Any) -> None:
    for message in (b"a", bytes(200_000), b"c"):
        await call.write(message)
        assert await call.read() == message


async def test_a_stream_uses_the_socket_that_the_host_offers(rig: Opened) -> None:
    async with rig() as opened:
        call = opened.begin(ECHO)
        await echo(call)
        assert opened.sockets == 1
        call.cancel()
        await until(lambda: opened.sockets == 0)


async def test_a_stream_uses_grpc_if_no_server_listens_at_the_socket(rig: Opened, tmp_path: Path) -> None:
    async with rig(offers=f"unix:{tmp_path}/0123456789abcdef.sock") as opened:
        call = opened.begin(ECHO)
        await echo(call)
        assert opened.sockets == 0
        call.cancel()


async def test_a_stream_uses_grpc_if_sockets_are_not_wanted(rig: Opened) -> None:
    async with rig(Transport.GRPC) as opened:
        call = opened.begin(ECHO)
        await echo(call)
        assert opened.sockets == 0
        call.cancel()


async def test_a_stream_that_must_use_a_socket_fails_without_one(rig: Opened, tmp_path: Path) -> None:
    async with rig(Transport.SOCKET, offers=f"unix:{tmp_path}/0123456789abcdef.sock") as opened:
        call = opened.begin(ECHO)
        with pytest.raises(Unavailable, match="no stream over a socket leads to"):
            await call.write(b"x")
        with pytest.raises(Unavailable, match="no stream over a socket leads to"):
            await call.read()
        call.cancel()


async def test_an_error_of_the_method_reaches_the_caller(rig: Opened) -> None:
    async with rig() as opened:
        with pytest.raises(grpc.RpcError) as caught:
            await opened.begin(REFUSE).read()
        error = from_rpc_error(caught.value, "the host")
        assert isinstance(error, InvalidArgument)
        assert error.metadata["field"] == "x"


async def test_a_cancelled_stream_ends_at_the_host(rig: Opened) -> None:
    async with rig() as opened:
        call = opened.begin(HOLD)
        reading = asyncio.ensure_future(call.read())
        await opened.at_socket.held.acquire()
        call.cancel()
        await opened.at_socket.cancelled.acquire()
        with pytest.raises(asyncio.CancelledError):
            await reading


async def test_a_stream_that_is_cancelled_while_it_opens_leaves_no_socket(rig: Opened) -> None:
    async with rig() as opened:
        for turns in range(6):
            call = opened.begin(ECHO)
            for _ in range(turns):
                await asyncio.sleep(0)
            call.cancel()
            await asyncio.wait([call._opening])
        await until(lambda: opened.sockets == 0)


async def test_connections_at_the_same_time_ask_the_host_for_its_sockets_once(rig: Opened) -> None:
    async with rig() as opened, opened.dial_again() as other:
        await echo(opened.begin(ECHO))
        await echo(other.stream_stream(ECHO)())  # type: ignore[call-arg]
        assert (opened.gatekeeper.calls, opened.sockets) == (1, 2)


async def test_a_host_whose_known_sockets_are_gone_is_asked_again(rig: Opened, tmp_path: Path) -> None:
    async with rig() as opened:
        gone = pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=f"unix:{tmp_path}/0123456789abcdef.sock")
        opened.known.keep(opened.address, [gone])
        await echo(opened.begin(ECHO))
        assert (opened.gatekeeper.calls, opened.sockets) == (1, 1)


@pytest.mark.parametrize("transport", [Transport.BEST, Transport.GRPC])
async def test_a_stream_is_logged_with_its_first_answer(
    rig: Opened, transport: Transport, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    async with rig(transport) as opened:
        call = opened.begin(ECHO)
        await call.write(b"a")
        assert not began(caplog)
        await call.read()
        assert len(began(caplog)) == (transport is Transport.BEST), "a connection without sockets logs nothing"


async def test_a_stream_to_a_host_that_nobody_reaches_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    async with dial("127.0.0.1:1", secret=None, transport=Transport.BEST) as channel:
        call = channel.stream_stream(ECHO)()  # type: ignore[call-arg]
        with pytest.raises(grpc.RpcError):
            await call.read()
    assert not began(caplog)


def began(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [one.getMessage() for one in caplog.records if getattr(one, "event", "") == "host_stream_began"]


def test_an_answer_counts_for_a_second_and_the_oldest_one_is_forgotten() -> None:
    now_s = 0.0
    known = KnownEndpoints(lambda: now_s)
    one = pb.DataEndpoint(target="unix:/x")
    for number in range(ANSWERS_MAX + 1):
        known.keep(f"h{number}", [one])
    assert (known.of("h0"), known.of("h1")) == ((), [one])
    now_s = ANSWER_SECONDS_MAX
    assert known.of("h1") == ()
