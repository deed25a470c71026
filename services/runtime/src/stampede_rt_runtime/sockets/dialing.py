"""The streams that a service opens at a host. They go over sockets if the host offers one, and otherwise over gRPC."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any

import grpc
from grpc.aio import EOF

from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import raise_from_rpc_error
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.machine import this_machine
from stampede_rt.transports.socket_async import OpeningCall, SocketCall
from stampede_rt.transports.socket_connecting_async import connect
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import SocketRoute, opening_of
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2_grpc
from stampede_rt_runtime.annotated_channel import AnnotatedChannel, Metadata

logger = logging.getLogger(__name__)

HEAD_START_S = 0.3
"""How long a new stream waits for a TCP connection before it uses gRPC. It may last for days, so it waits longer than
the streams of a client."""


class SocketChannel(AnnotatedChannel):
    """A connection to a host for one stream in both directions, over a socket or else over gRPC.

    Once the stream has a socket, the connection of gRPC is closed.
    """

    def __init__(
        self, over_grpc: grpc.aio.Channel, target: str, transport: Transport, tls: TlsReader | None = None
    ) -> None:
        """`target` and `tls`: those of the connection `over_grpc`."""
        super().__init__(over_grpc, tuple)
        self._target, self._transport, self._tls = target, transport, tls
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
            return HostStream(self._begun(bidi, metadata or ()))

        return begin

    async def _begun(self, method: BidiMethod, metadata: Metadata) -> Any:
        # A host that has started again has other sockets, and certificates change. So each stream asks anew.
        route = SocketRoute(self._target, self._transport, None if self._tls is None else self._tls.current())
        route.tcp.head_start_s = HEAD_START_S
        connected = await connect(route, partial(self._ask, metadata))
        used = Transport.GRPC if connected is None else Transport.SOCKET if connected.is_local else Transport.TCP
        extra = {"event": "host_stream_began", "target": self._target, "transport": used.value}
        logger.info("a stream to another host begins", extra=extra)
        if connected is None:
            if route.tcp.reaching is not None:
                route.tcp.reaching.cancel()
            return method(metadata=metadata or None)
        opening = opening_of(method.name, metadata, route.ticket if connected.is_local else b"")
        call = await SocketCall.begun(connected.socket, method, opening, connected.tls)
        await self.close()
        return call

    async def _ask(self, metadata: Metadata) -> Sequence[pb.DataEndpoint]:
        """The sockets of the host for a caller on this machine. Raises StampedeError."""
        request = pb.ListDataEndpointsRequest(machine=this_machine())
        try:
            answer: Awaitable[Any] = self._gatekeeper.ListDataEndpoints(
                request, timeout=CONNECT_S_MAX, metadata=metadata or None
            )
            found: Sequence[pb.DataEndpoint] = (await answer).endpoints
        except grpc.RpcError as error:
            raise_from_rpc_error(error, self._target)
        return found


class HostStream(OpeningCall):
    """A stream whose transport is not known yet, with `read` as in grpc.aio. It takes requests of one message."""

    def answer_at_once(self, take: Callable[[Any], bool]) -> None:
        """See `SocketCall`. Does nothing over gRPC. Call it after the first response."""
        if isinstance(self._call, SocketCall):
            self._call.at_once = take

    @property
    def write_now(self) -> Callable[[Any], None] | None:
        """See `SocketCall`. None over gRPC."""
        return self._call.write_now if isinstance(self._call, SocketCall) else None

    async def read(self) -> Any:
        """The next response, or EOF. Raises grpc.RpcError, and StampedeError if the stream could not be opened."""
        call = self._call or await asyncio.shield(self._opening)
        if not isinstance(call, SocketCall):
            return await call.read()
        try:
            return await anext(call)
        except StopAsyncIteration:
            return EOF
