"""The streams that a service opens at a host. They go over sockets if the host offers one, and otherwise over gRPC."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import grpc
from grpc.aio import EOF

from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import Unavailable
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import raise_from_rpc_error
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.machine import this_machine
from stampede_rt.transports.socket_async import OpeningCall, SocketCall
from stampede_rt.transports.socket_connecting_async import connect
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import SocketRoute, opening_of
from stampede_rt.transports.tcp_route import SocketConnection
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2_grpc
from stampede_rt_runtime.annotated_channel import AnnotatedChannel, Metadata

logger = logging.getLogger(__name__)

HEAD_START_S = 0.3
"""The time in seconds that a new stream waits for a TCP connection before it uses gRPC.

A stream between hosts may last for days, so it waits longer than a client's stream.
"""
ANSWERS_MAX, ANSWER_SECONDS_MAX = 256, 1.0  # a host that is drained opens a stream for each channel

Endpoints = Sequence[pb.DataEndpoint]


class KnownEndpoints:
    """The latest answers of hosts that were asked for their sockets, each for ANSWER_SECONDS_MAX.

    A host that has started again has other sockets, and certificates change. So no answer is kept for longer.
    """

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._answers: OrderedDict[str, tuple[float, Endpoints]] = OrderedDict()

    def of(self, target: str) -> Endpoints:
        """The sockets of the host at `target`. Empty: ask the host."""
        until_s, endpoints = self._answers.get(target, (0.0, ()))
        return endpoints if self._clock_s() < until_s else ()

    def keep(self, target: str, endpoints: Endpoints) -> None:
        """Keep an answer. Beyond ANSWERS_MAX, forget the oldest one."""
        self._answers[target] = self._clock_s() + ANSWER_SECONDS_MAX, endpoints
        self._answers.move_to_end(target)
        if len(self._answers) > ANSWERS_MAX:
            self._answers.popitem(last=False)

    def forget(self, target: str) -> None:
        """Forget the answer, because nobody takes connections there. Idempotent."""
        self._answers.pop(target, None)


class SocketChannel(AnnotatedChannel):
    """A connection to a host for one stream in both directions, over a socket or else over gRPC.

    When the stream has a socket, the connection of gRPC is closed.
    """

    def __init__(
        self, over_grpc: grpc.aio.Channel, target: str, transport: Transport, tls: TlsReader | None,
        known: KnownEndpoints,
    ) -> None:  # fmt: skip
        """`target` and `tls`: the address and the certificates of the connection `over_grpc`. `known`: the answers to
        earlier connections."""
        super().__init__(over_grpc, tuple)
        self._target, self._transport, self._tls, self._known = target, transport, tls, known
        self._used = Transport.GRPC
        self._gatekeeper = gatekeeper_service_pb2_grpc.GatekeeperServiceStub(over_grpc)

    def stream_stream(
        self,
        method: str,
        request_serializer: Callable[[Any], bytes] | None = None,
        response_deserializer: Callable[[bytes], Any] | None = None,
        **named: Any,
    ) -> Any:
        """A callable for a stream in both directions. It returns a stream that opens in the background."""
        over_grpc = self._inner.stream_stream(method, request_serializer, response_deserializer, **named)
        bidi = BidiMethod(method, request_serializer, response_deserializer, over_grpc)

        def begin(*, metadata: Metadata | None = None) -> HostStream:
            return HostStream(self._open_stream(bidi, metadata or ()), self._log_transport)

        return begin

    async def _open_stream(self, method: BidiMethod, metadata: Metadata) -> Any:
        route, connected = await self._connected(metadata)
        if connected is None:
            return method(metadata=metadata or None)
        self._used = Transport.SOCKET if connected.is_local else Transport.TCP
        opening = opening_of(method.name, metadata, route.ticket if connected.is_local else b"")
        call = await SocketCall.open(connected.socket, method, opening, connected.tls)
        await self.close()
        return call

    async def _connected(self, metadata: Metadata) -> tuple[SocketRoute, SocketConnection | None]:
        """A new connection, and its route. Asks the host for its sockets if nobody takes a connection at the known
        sockets."""
        ask = partial(self._ask, metadata)
        if known := self._known.of(self._target):
            route = self._route()
            route.learn(known)
            with suppress(Unavailable):
                if (connected := await _only_now(route, ask)) is not None:
                    return route, connected
            self._known.forget(self._target)
        route = self._route()
        return route, await _only_now(route, ask)

    def _route(self) -> SocketRoute:
        route = SocketRoute(self._target, self._transport, None if self._tls is None else self._tls.current())
        route.tcp.head_start_s = HEAD_START_S
        return route

    def _log_transport(self) -> None:
        """Log the transport after the host's first answer: over gRPC a stream also begins if no host is at its
        target."""
        extra = {"event": "host_stream_began", "target": self._target, "transport": self._used.value}
        logger.info("a stream to another host begins", extra=extra)

    async def _ask(self, metadata: Metadata) -> Sequence[pb.DataEndpoint]:
        """The sockets of the host for a caller on this machine. Raises StampedeError."""
        request = pb.ListDataEndpointsRequest(machine=this_machine())
        try:
            answer: Awaitable[Any] = self._gatekeeper.ListDataEndpoints(
                request, timeout=CONNECT_S_MAX, metadata=metadata or None
            )
            found: Endpoints = (await answer).endpoints
        except grpc.RpcError as error:
            raise_from_rpc_error(error, self._target)
        self._known.keep(self._target, found)
        return found


async def _only_now(route: SocketRoute, ask: Callable[[], Awaitable[Endpoints]]) -> SocketConnection | None:
    """See `connect`. Nobody uses a connection that comes later."""
    connected = None
    try:
        connected = await connect(route, ask)
    finally:
        if connected is None and route.tcp.reaching is not None:
            route.tcp.reaching.cancel()
    return connected


class HostStream(OpeningCall):
    """A stream whose transport is not known yet, with `read` as in grpc.aio. It takes requests of one message."""

    def __init__(self, opening: Awaitable[Any], on_answer: Callable[[], None]) -> None:
        """See `OpeningCall`. Calls `on_answer` with the first response."""
        super().__init__(opening)
        self._on_answer: Callable[[], None] | None = on_answer

    def answer_in_same_turn(self, take: Callable[[Any], bool]) -> None:
        """See `SocketCall`. Does nothing over gRPC. Call it after the first response."""
        if isinstance(self._call, SocketCall):
            self._call.take_in_same_turn = take

    @property
    def write_now(self) -> Callable[[Any], None] | None:
        """See `SocketCall`. None over gRPC."""
        return self._call.write_now if isinstance(self._call, SocketCall) else None

    async def read(self) -> Any:
        """The next response, or EOF. Raises grpc.RpcError, and StampedeError if the stream could not be opened."""
        call = self._call or await asyncio.shield(self._opening)
        response = await (anext(call, EOF) if isinstance(call, SocketCall) else call.read())
        if self._on_answer is not None and response is not EOF:
            self._on_answer()
            self._on_answer = None
        return response
