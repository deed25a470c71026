"""A service whose methods have streams in both directions, at sockets of each kind.

`port = port_fixture()` in a test file makes a fixture that opens these sockets.
"""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from functools import cache
from pathlib import Path
from typing import Any

import grpc
import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.security.tls import TlsReader
from stampede_rt.security.tls_contexts import client_context
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime import roles
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.rpc import answer_in_same_turn, errors_as_status, takes_parts
from stampede_rt_runtime.server import ServiceServer, serving
from stampede_rt_runtime.sockets.stream_socket import StreamSocket
from stampede_rt_runtime.tls import load_tls
from tests.support.raw_stream import SECURED

SERVICE = "test.Streams"
ECHO, HOLD, READ_LATER, REFUSE, FAIL, FLOOD, SAME_TURN = (
    f"/{SERVICE}/{name}" for name in ("Echo", "Hold", "ReadLater", "Refuse", "Fail", "Flood", "SameTurn")
)


class Streams:
    """Methods with streams in both directions."""

    def __init__(self) -> None:
        self.held = asyncio.Semaphore(0)
        self.cancelled = asyncio.Semaphore(0)
        self.may_read = asyncio.Event()
        self.read_bytes = 0

    def add_to(self, server: Any) -> None:
        methods = {
            "Echo": self.echo, "Hold": self.hold, "ReadLater": self.read_later, "Refuse": self.refuse,
            "Fail": self.fail, "Flood": self.flood, "SameTurn": self.same_turn,
        }  # fmt: skip
        handlers: dict[str, Any] = {
            name: grpc.stream_stream_rpc_method_handler(method) for name, method in methods.items()
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))
        server.add_registered_method_handlers(SERVICE, handlers)

    async def echo(self, _requests: Any, context: Any) -> None:
        """Return each message, a very long one in parts."""
        while (message := await context.read()) is not grpc.aio.EOF:
            is_long = len(message) > 100_000 and takes_parts(context)
            await context.write((message[:10], b"", message[10:]) if is_long else message)

    async def same_turn(self, _requests: Any, context: Any) -> None:
        """Answer short messages in the turn in which they come, the others later, and fail at "defect"."""

        def take(message: bytes, write: Callable[[bytes], None]) -> bool:
            if message == b"defect":
                raise ValueError("a defect")
            if len(message) <= 5:
                write(b"same turn: " + message)
            return len(message) <= 5

        answer_in_same_turn(context, take)
        await self.echo(_requests, context)

    async def hold(self, _requests: Any, context: Any) -> None:
        self.held.release()
        try:
            await asyncio.Event().wait()
        finally:
            self.cancelled.release()

    async def read_later(self, _requests: Any, context: Any) -> None:
        """Read one message, and the other messages when the test allows it."""
        self.held.release()
        try:
            self.read_bytes += len(await context.read())
            await self.may_read.wait()
            while (message := await context.read()) is not grpc.aio.EOF:
                self.read_bytes += len(message)
        finally:
            self.cancelled.release()

    @errors_as_status
    async def refuse(self, _requests: Any, context: Any) -> None:
        raise InvalidArgument("not like this", metadata={"field": "x"})

    async def fail(self, _requests: Any, context: Any) -> None:
        raise ValueError("a defect")

    async def flood(self, _requests: Any, context: Any) -> None:
        self.held.release()
        try:
            while True:
                await context.write(bytes(100_000))
        finally:
            self.cancelled.release()


class Port:
    """A service, the target of its socket, and its server."""

    def __init__(self, streams: Streams, target: str, server: ServiceServer) -> None:
        self.streams, self.target, self.server = streams, target, server


async def until(condition: Callable[[], object]) -> None:
    """Wait until the condition is true, while the server's event loop runs."""
    async with asyncio.timeout(20):
        while not condition():  # noqa: ASYNC110  # the state has no event
            await asyncio.sleep(0)


async def paused(one: Port) -> StreamSocket:
    """Wait until the only connection reads no more messages, and return it."""
    return await paused_by(one.server)


async def paused_by(server: ServiceServer) -> StreamSocket:
    """Wait until the only connection of a server reads no more messages, and return it."""
    await until(lambda: [made for made in server.sockets._streams if made._is_paused])
    [made] = server.sockets._streams
    return made


Open = Callable[..., AbstractAsyncContextManager[Port]]


LOCAL, TCP, TLS = "unix", "tcp", "tls"


@cache
def certificates() -> ClusterCertificates:
    """The certificates of all tests of this process."""
    return ClusterCertificates(Path(tempfile.mkdtemp(prefix="stampede-tests-"), "certs"))


def port_fixture(*kinds: str) -> Callable[..., Open]:
    """Return a fixture whose value opens a Port. The settings of that call go to `serving`.

    Tests run once for each of `kinds`; by default, for all kinds of sockets.
    """

    @pytest.fixture(params=kinds or (LOCAL, TCP, TLS))
    def port(tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Open:
        kind = request.param
        monkeypatch.setitem(roles._FOREIGN, f"/{SERVICE}/", frozenset({Role.CLIENT, Role.OPERATOR}))  # type: ignore[arg-type]

        @asynccontextmanager
        async def opened(**settings: Any) -> AsyncIterator[Port]:
            streams = Streams()
            if kind == TLS:
                settings["tls"] = load_tls(certificates().issue(Role.HOST, "h1"), Role.HOST)
            async with serving(streams.add_to, **settings) as server:
                server.sockets.register(streams.add_to)
                if kind == LOCAL:
                    yield Port(streams, await server.sockets.listen_locally(tmp_path / "s"), server)
                    return
                target = f"tcp:localhost:{server.bind_sockets(0)}"
                if kind == TLS:
                    files = certificates().issue(Role.OPERATOR, "tests")
                    SECURED[target] = client_context(TlsReader(files).current())
                try:
                    yield Port(streams, target, server)
                finally:
                    SECURED.pop(target, None)

        return opened

    return port
