"""Serves streams over sockets of their own. The calls pass the same interceptors as the calls of the gRPC server."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections import OrderedDict, deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import grpc
from grpc.aio import AbortError

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.errors import Overloaded, PermissionDenied, StampedeError, VersionMismatch
from stampede_rt.status import encode_status
from stampede_rt.transports.machine import enlarge_send_buffer, is_of_this_user
from stampede_rt.transports.tls_layer import TlsLayer
from stampede_rt.v1 import socket_stream_pb2 as pb
from stampede_rt.wire.stream_frames import PROTOCOL_VERSION, FrameKind, frame_of
from stampede_rt_runtime.error_frames import failure_of
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.open_files import connections_max
from stampede_rt_runtime.overload import RefusedCalls
from stampede_rt_runtime.sockets.accepting import Acceptor
from stampede_rt_runtime.sockets.context import OK, Metadata, SocketContext, status_of
from stampede_rt_runtime.sockets.frame_buffers import FrameBuffers
from stampede_rt_runtime.sockets.hangups import HangupWatcher
from stampede_rt_runtime.sockets.stream_socket import LOCAL_PEER, StreamSocket
from stampede_rt_runtime.sockets.tcp_socket import peer_of
from stampede_rt_runtime.sockets.tickets import SocketTickets
from stampede_rt_runtime.sockets.tls_stream import HandshakeSteps, TlsStream
from stampede_rt_runtime.sockets.unix_socket import listen_at_new_path
from stampede_rt_runtime.sockets.unopened import UnopenedStreams

logger = logging.getLogger(__name__)

ALIVE_SECONDS = 2.5
LOOKS_PER_TURN = 64
OPENED_PER_TURN = 2
ENDED_PER_TURN = 64


class _CallDetails(NamedTuple):
    """The facts of a call that interceptors read, as in grpc.HandlerCallDetails."""

    method: str
    invocation_metadata: Metadata


class _Stream:
    """A connection and the task that serves it."""

    __slots__ = ("connection", "task")

    def __init__(self, connection: StreamSocket) -> None:
        self.connection = connection
        self.task: asyncio.Task[None] | None = None


class SocketServer:
    """The RPCs with streams in both directions, each over a socket of its own.

    Order of use, on the event loop that serves: make it, register servicers as on a grpc.aio.Server, `listen_locally`
    and `listen_over_tcp`, `stop`. `interceptors` are the interceptors of the gRPC server, so that both servers count
    and limit calls together.
    """

    def __init__(
        self, interceptors: Sequence[grpc.aio.ServerInterceptor], limits: Limits, refused: RefusedCalls
    ) -> None:
        self.tickets = SocketTickets()
        self._limits, self._refused = limits, refused
        self._methods: dict[str, Any] = {}
        find: Any = self._method
        for interceptor in reversed(interceptors):
            find = partial(interceptor.intercept_service, find)
        self._find: Callable[[_CallDetails], Awaitable[Any]] = find
        self._hangups, self._buffers = HangupWatcher(), FrameBuffers()
        self._streams: dict[StreamSocket, _Stream] = {}
        # Connections without an opening. TCP connections count separately, so that other machines do not keep local
        # callers out.
        connections_max = limits.refusals_max
        self._unopened = {
            True: UnopenedStreams(connections_max, connections_max),
            False: UnopenedStreams(connections_max, -(-connections_max * 3 // 4)),
        }
        # one line for each credential: a caller with a thousand openings delays other callers by one opening only
        self._openings: OrderedDict[str, deque[tuple[_Stream, pb.StreamOpening]]] = OrderedDict()
        self._changed = asyncio.Event()
        self._acceptors: list[Acceptor] = []
        self._steps = HandshakeSteps()
        self._connecting: set[asyncio.Task[Any]] = set()
        self._sweep: asyncio.Task[None] | None = None
        self._path: Path | None = None

    @property
    def streams_open(self) -> int:
        """The number of open connections. Each of them carries one stream."""
        return len(self._streams)

    def register(self, add_to: Callable[[Any], object]) -> None:
        """Serve the methods that `add_to` adds to a grpc.aio.Server."""
        add_to(self)

    def add_generic_rpc_handlers(self, handlers: Sequence[Any]) -> None:
        """Do nothing: the same handlers come by `add_registered_method_handlers`."""

    def add_registered_method_handlers(self, service: str, handlers: Mapping[str, Any]) -> None:
        """Serve the methods that have streams in both directions."""
        for name, handler in handlers.items():
            if handler.request_streaming and handler.response_streaming:
                self._methods[f"/{service}/{name}"] = handler

    async def listen_locally(self, folder: Path | None = None) -> str:
        """Listen at a Unix socket. Returns its target, "unix:PATH". Raises CannotListen."""
        listening, self._path = listen_at_new_path(folder)
        self._accept(listening, self._accepted_locally)
        return f"unix:{self._path}"

    def listen_over_tcp(
        self, listening: Sequence[socket.socket], context: Callable[[], ssl.SSLContext] | None = None
    ) -> None:
        """Accept the connections of these TCP sockets.

        `context`: returns the TLS of a new connection, whose caller must present a certificate; None: plain text.
        """
        for one in listening:
            self._accept(one, partial(self._accepted_over_tcp, context))

    def _accept(self, listening: socket.socket, take: Callable[[socket.socket], object]) -> None:
        self._acceptors.append(Acceptor(listening, take))
        self._acceptors[-1].start()
        self._sweep = self._sweep or asyncio.create_task(self._look_forever())

    async def stop(self, grace_s: float) -> None:
        """Accept no more connections, wait at most `grace_s` until all streams have ended, and end the others."""
        for acceptor in self._acceptors:
            acceptor.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)
        try:
            async with asyncio.timeout(grace_s):
                while any(one.task is not None and not one.task.done() for one in self._streams.values()):
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            logger.warning(
                "streams did not end in time; the server ends them",
                extra={"event": "streams_cut_off", "seconds": grace_s},
            )
        for number, connection in enumerate(tuple(self._streams), start=1):
            connection.abort()
            if number % ENDED_PER_TURN == 0:
                await asyncio.sleep(0)
        if self._sweep is not None:
            self._sweep.cancel()
        for connecting in tuple(self._connecting):
            connecting.cancel()
        self._hangups.close()

    def _accepted_locally(self, accepted: socket.socket) -> None:
        """Serve a connection of this user's programs."""
        error = None
        if not is_of_this_user(accepted):
            error = PermissionDenied("the socket belongs to another user of this machine")
        enlarge_send_buffer(accepted)
        self._accepted(accepted, error, self._connection())

    def _accepted_over_tcp(self, context: Callable[[], ssl.SSLContext] | None, accepted: socket.socket) -> None:
        """Serve a connection of any caller that reaches the port."""
        try:
            made = self._connection(peer_of(accepted))
        except OSError:  # the caller has gone
            accepted.close()
            return
        if context is None:
            self._accepted(accepted, None, made)
            return
        handshake_s = self._limits.handshake_millis_max / 1000
        secured = TlsStream(made, TlsLayer(context()), self._steps, self._buffers.short, handshake_s)
        self._accepted(accepted, None, made, secured)

    def _accepted(
        self,
        accepted: socket.socket,
        error: StampedeError | None,
        made: StreamSocket,
        secured: TlsStream | None = None,
    ) -> None:
        """Serve a connection.

        If it has an error, or is beyond the limits, refuse it before the service reads any of its bytes.
        """
        error = error or self._too_many(made)
        if error is not None:  # does not wait until the peer has read it, because there may be many such peers
            with contextlib.suppress(OSError), accepted:
                if secured is None:
                    accepted.send(frame_of(FrameKind.STATUS, encode_status(error)))
            return
        self._streams[made] = _Stream(made)
        self._unopened[made.is_local].add(made)
        connect = asyncio.get_running_loop().connect_accepted_socket(lambda: secured or made, accepted)
        connecting = asyncio.create_task(connect)
        self._connecting.add(connecting)
        connecting.add_done_callback(partial(self._connected, made, accepted))

    def _connection(self, peer: str = LOCAL_PEER) -> StreamSocket:
        return StreamSocket(self, self._limits, self._hangups, self._buffers, peer)

    def _connected(self, connection: StreamSocket, accepted: socket.socket, connecting: asyncio.Task[Any]) -> None:
        self._connecting.discard(connecting)
        if connecting.cancelled() or connecting.exception() is not None:
            accepted.close()  # a task that was cancelled before its first step has not closed it
            self.lost(connection)

    def _too_many(self, made: StreamSocket) -> StampedeError | None:
        unopened = self._unopened[made.is_local]
        if unopened.has_room_for(made.machine) and len(self._streams) < connections_max() // 2:
            return None
        error = Overloaded(
            f"{len(self._streams)} sockets are open at this service, {len(unopened)} of them without a StreamOpening; "
            "it serves no more; close some streams, or go to another host"
        )
        self._refused.note(error)
        return error

    def opened(self, connection: StreamSocket, opening: pb.StreamOpening) -> None:
        """Begin to serve a stream. Raises VersionMismatch."""
        self._unopened[connection.is_local].discard(connection)
        if opening.protocol_version != PROTOCOL_VERSION:
            raise VersionMismatch(
                f"the caller has version {opening.protocol_version} of the frames of streams, and this service version "
                f"{PROTOCOL_VERSION}; install the same release on both"
            )
        if not self._openings:
            asyncio.get_running_loop().call_soon(self._begin_some)
        line = self._openings.setdefault(opening.authorization, deque())
        line.append((self._streams[connection], opening))

    def _begin_some(self) -> None:
        """Begin to serve a few streams, and the others in the next turns of the loop."""
        for _ in range(OPENED_PER_TURN):
            if not self._openings:
                return
            credential, line = self._openings.popitem(last=False)
            stream, opening = line.popleft()
            if line:
                self._openings[credential] = line  # after the others
            if stream.connection in self._streams:
                stream.task = asyncio.create_task(self._serve(stream, opening))
                stream.task.add_done_callback(self._note_end)
        if self._openings:
            asyncio.get_running_loop().call_soon(self._begin_some)

    def failed(self, connection: StreamSocket, error: StampedeError) -> None:
        """End a stream whose frames are invalid."""
        connection.end(encode_status(error))
        self._cancel_stream(connection)

    def lost(self, connection: StreamSocket) -> None:
        """Cancel the stream of a connection that has gone, and forget it."""
        self._cancel_stream(connection)
        self._streams.pop(connection, None)

    def _cancel_stream(self, connection: StreamSocket) -> None:
        self._unopened[connection.is_local].discard(connection)
        stream = self._streams.get(connection)
        if stream is not None and stream.task is not None:
            stream.task.cancel()

    def _note_end(self, task: asyncio.Task[None]) -> None:
        # `_Stream` keeps the task, and the frames of a cancelled task refer to its `_Stream`. This call removes them.
        failure_of(task)
        self._changed.set()

    async def _serve(self, stream: _Stream, opening: pb.StreamOpening) -> None:
        connection, metadata = stream.connection, _metadata(opening)
        try:
            handler = await self._find(_CallDetails(opening.method, metadata))
            certificate = self.tickets.certificate_of(opening.ticket) if connection.is_local else connection.certificate
            context = SocketContext(connection, metadata, connection.peer, certificate, handler)
            await handler.stream_stream(context, context)
            connection.end(OK)
        except AbortError:
            pass  # the status is written
        except asyncio.CancelledError:
            if not connection.is_over:
                connection.abort()
        except Exception as defect:
            logger.exception("a method failed", extra={"event": "method_defect", "method": opening.method})
            connection.end(status_of(grpc.StatusCode.UNKNOWN, f"Unexpected {type(defect)}: {defect}"))

    async def _method(self, details: _CallDetails) -> Any:
        return self._methods.get(details.method)

    async def _look_forever(self) -> None:
        """Look at all connections, a few in each turn of the loop."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(ALIVE_SECONDS)
            for number, connection in enumerate(tuple(self._streams), start=1):
                connection.look(loop.time())
                if number % LOOKS_PER_TURN == 0:
                    await asyncio.sleep(0)


def _metadata(opening: pb.StreamOpening) -> Metadata:
    credential = (("authorization", opening.authorization),) if opening.authorization else ()
    trace = (("traceparent", opening.trace_parent),) if opening.trace_parent else ()
    return credential + cluster_metadata(opening.cluster_id) + trace
