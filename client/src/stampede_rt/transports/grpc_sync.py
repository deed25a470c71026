"""gRPC on threads, with the names of `grpc_async`. The calls block. A stream belongs to the thread that opened it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar
from weakref import WeakSet

import grpc
import grpc.experimental

from stampede_rt.cluster.call_metadata import CallMetadata
from stampede_rt.cluster.request_age import age_metadata
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.security.tls import TlsMaterial
from stampede_rt.status import from_rpc_error, raise_from_rpc_error
from stampede_rt.transports import single_thread_call
from stampede_rt.transports.bidi_methods import BidiMethod, BidiMethods
from stampede_rt.transports.call_stream_sync import CallStream, LockstepStream
from stampede_rt.transports.concurrency_sync import within_limit
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS, ENQUEUE_METHOD, PUT_METHOD
from stampede_rt.transports.machine import this_machine
from stampede_rt.transports.ring_mapping import RingMapping, receive_ring
from stampede_rt.transports.single_thread_call import SingleThreadCall
from stampede_rt.transports.socket_connecting_sync import connect
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import SocketRoute, opening_of
from stampede_rt.transports.socket_sync import SocketCall
from stampede_rt.transports.streams_sync import BidiStream, GrpcCall, ServerStream, closed
from stampede_rt.transports.stubs import Stubs
from stampede_rt.transports.watchdog import Watchdog
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.delivered import ItemCount

Response = TypeVar("Response")
Stub = TypeVar("Stub")


def _open_channel(target: str, tls: TlsMaterial | None) -> grpc.Channel:
    options = (*CHANNEL_OPTIONS, (grpc.experimental.ChannelOptions.SingleThreadedUnaryStream, 1))
    if tls is None:
        return grpc.insecure_channel(target, options=options)
    return grpc.secure_channel(target, channel_credentials(tls), options=options)


class ServerEndpoint(Stubs):
    """A gRPC connection to one address. All calls to this address share it."""

    def __init__(
        self,
        target: str,
        metadata: CallMetadata,
        tls: TlsMaterial | None = None,
        transport: Transport = Transport.GRPC,
    ) -> None:
        self.target = target
        self.route = SocketRoute(target, transport, tls)
        self._metadata = metadata
        self._channel = _open_channel(target, tls)
        methods = BidiMethods(self._channel)
        super().__init__(methods)
        # wire/put_frames.py encodes the requests, so the streams send them without a serializer.
        self._put = methods.stream_stream(PUT_METHOD, response_deserializer=channel_pb.PutResponse.FromString)
        self._enqueue = methods.stream_stream(ENQUEUE_METHOD, response_deserializer=queue_pb.EnqueueResponse.FromString)
        self._watchdog = Watchdog()
        self._thread_local = threading.local()
        self._call_streams: WeakSet[CallStream] = WeakSet()
        self._socket_calls: WeakSet[SocketCall] = WeakSet()
        self._mutex = threading.Lock()  # guards the streams, and the calls over sockets
        self._closed = False
        self.is_stuck = False
        """Whether an interrupt has left a lock of gRPC locked. gRPC's threads then serve no call of this endpoint."""

    def stub(self, make: Callable[[grpc.Channel], Stub]) -> Stub:
        """Return the stub of a service that has no attribute here, such as `MembershipServiceStub`.

        Pass its methods to `call`.
        """
        return make(self._channel)

    def call(self, method: Callable[..., Any], request: Any, timeout_s: float, age_s: float = 0.0) -> Any:
        """Make one call, within `timeout_s`. Raises StampedeError.

        `age_s`: the seconds since the client first sent this update.
        """
        try:
            return method(request, timeout=timeout_s, metadata=self._metadata() + age_metadata(age_s))
        except grpc.RpcError as error:
            raise_from_rpc_error(error, self.target)
        except ValueError as error:  # gRPC raises this for a closed channel
            raise closed(self.target) from error

    def stream(self, method: Callable[..., Any], request: Any) -> ServerStream[Any]:
        """Open a stream of responses to one request."""
        return ServerStream(self.begin(method, request), self.target, self._watchdog)

    def begin(self, method: Callable[..., Any], requests: Any) -> Any:
        """Begin the call of a stream. Raises Unavailable when this endpoint is closed."""
        try:
            return method(requests, metadata=self._metadata())
        except ValueError as error:
            raise closed(self.target) from error

    def begin_bidi(
        self, method: BidiMethod, *, in_turn: bool = False, keeps_reading: bool = False
    ) -> GrpcCall | SingleThreadCall | SocketCall:
        """Begin the call of a stream in both directions. Raises Unavailable when this endpoint is closed.

        `in_turn`: see `SocketCall`. `keeps_reading`: whether the caller continues to read, see `SingleThreadCall`.
        """
        connected = connect(self.route, self._ask_for_sockets)
        if connected is None:
            return self._begin_over_grpc(method, keeps_reading=keeps_reading)
        opening = opening_of(method.name, self._metadata(), self.route.ticket if connected.is_local else b"")
        call = SocketCall(connected.socket, method, opening, in_turn=in_turn, tls=connected.tls)
        with self._mutex:
            self._socket_calls.add(call)
            over = self._closed
        if over:
            call.cancel()
            raise closed(self.target)
        return call

    def _begin_over_grpc(self, method: BidiMethod, *, keeps_reading: bool) -> GrpcCall | SingleThreadCall:
        try:
            call = single_thread_call.begin(self._channel, method, self._metadata()) if keeps_reading else None
        except ValueError as error:
            raise closed(self.target) from error
        return call or GrpcCall(partial(self.begin, method))

    def _ask_for_sockets(self) -> Sequence[gatekeeper_pb.DataEndpoint]:
        request = gatekeeper_pb.ListDataEndpointsRequest(machine=this_machine())
        response = self.call(self.gatekeeper.ListDataEndpoints, request, CONNECT_S_MAX)
        endpoints: Sequence[gatekeeper_pb.DataEndpoint] = response.endpoints
        return endpoints

    def transport(self) -> str:
        """Return the transport of new streams in both directions. Connects to find out, so it may block for 2 s.

        Raises Unavailable if the program has chosen sockets, and none can be used.
        """
        connected = connect(self.route, self._ask_for_sockets)
        if connected is None:
            return Transport.GRPC.value
        connected.close()
        return (Transport.SOCKET if connected.is_local else Transport.TCP).value

    def share_memory(self, channel_id: bytes, epoch: int) -> RingMapping | None:
        """Return the ring of a channel; None: the host shares no memory. Blocks for 4 s at most; see `receive_ring`."""
        connected = connect(self.route, self._ask_for_sockets)
        return receive_ring(self.route, connected, self._metadata(), channel_id, epoch)

    def open_bidi(self, method: BidiMethod) -> BidiStream[Any]:
        """Open a stream in both directions."""
        return BidiStream(self.begin_bidi(method), self.target, self._watchdog)

    def open_read_bidi(self, method: BidiMethod) -> BidiStream[Any]:
        """Open a stream in both directions, for a caller that reads after it has sent."""
        return BidiStream(self.begin_bidi(method, keeps_reading=True), self.target, self._watchdog)

    def gets(self) -> GetExchange:
        """Return this thread's open stream for gets."""
        exchange: GetExchange | None = getattr(self._thread_local, "gets", None)
        if exchange is not None and exchange.is_outdated:
            exchange.cancel()
        if exchange is None or exchange.broken:
            exchange = self._thread_local.gets = GetExchange(self, self.channels.Get, self._watchdog)
        return exchange

    def puts(self) -> PutExchange:
        """Open a stream for puts. The caller closes it."""
        return PutExchange(self, self._put, self._watchdog)

    def enqueues(self) -> PutExchange:
        """Open a stream for puts into a queue. The caller closes it."""
        return PutExchange(self, self._enqueue, self._watchdog)

    def duplex(
        self, on_response: Callable[[channel_pb.PutResponse], None], on_end: Callable[[StampedeError], None]
    ) -> PutDuplex:
        """Open a stream whose puts do not wait for their acks. The stream passes each response to `on_response`."""
        return PutDuplex(self, self._put, on_response, on_end)

    def close(self) -> None:
        """End all calls and streams, within END_LIMIT_S."""
        within_limit(self._close)

    def _close(self) -> None:
        self._watchdog.close()
        self._channel.close()
        with self._mutex:
            self._closed = True
            streams, calls = tuple(self._call_streams), tuple(self._socket_calls)
        for call in calls:
            call.cancel()
        for stream in streams:  # gRPC's sending threads wait for requests even when the channel is closed
            stream.end()

    def opened(self, stream: CallStream) -> None:
        """Keep a weak reference to `stream`, and end the stream when this endpoint closes."""
        with self._mutex:
            self._call_streams.add(stream)
            over = self._closed
        if over:  # the endpoint was closed after the call began
            stream.end()

    def ended(self) -> None:
        """Return immediately. The threads of streams are daemons, and end by themselves."""


class GetExchange(LockstepStream):
    """Gets on one open stream, one at a time."""

    def get(self, request: channel_pb.GetRequest, timeout_s: float | None) -> list[channel_pb.GetResponse]:
        """Give `request` a call id, send it, and return all responses.

        Blocks for at most `timeout_s` seconds; None: without limit. Raises StampedeError, DeadlineExceeded after
        `timeout_s`.
        """
        self._next_id += 1
        request.call_id = self._next_id
        with self._limit(timeout_s) as limit:
            self._call.send(request)
            responses, count = [self._next(limit)], ItemCount(request.limit)
            while True:  # ends with the last response, or if the host sends more items than it may
                self._check(count, responses[-1])
                if responses[-1].HasField("summary") or responses[-1].HasField("error"):
                    return responses
                responses.append(self._next(limit))

    def _check(self, count: ItemCount, response: channel_pb.GetResponse) -> None:
        try:
            count.add(one.run for one in response.runs)
        except StampedeError:
            self.cancel()  # no code reads the rest of the answer
            raise


class PutExchange(LockstepStream):
    """Puts on one open stream, one at a time."""

    one_at_a_time = True
    """Whether a stream has at most one put under way."""

    def put(self, request: bytes, timeout_s: float | None, *, survives_cancel: bool = False) -> channel_pb.PutAck:
        """Send the run in `request`, and return its ack. `timeout_s` and the errors are as in `GetExchange.get`.

        Only the stream on asyncio uses `survives_cancel`. An interrupt always ends this stream, because the
        next answer would belong to the interrupted put.
        """
        with self._limit(timeout_s) as limit:
            self._call.send(request)
            acks: Sequence[channel_pb.PutAck] = self._next(limit).acks
        if len(acks) != 1:
            self.cancel()
            raise Unavailable(f"{self._target} sent {len(acks)} acks for one put")
        return acks[0]


class PutDuplex(CallStream):
    """Puts on one open stream. A thread passes each response to `on_response`, and calls `on_end` once at the end."""

    def __init__(
        self,
        endpoint: ServerEndpoint,
        method: BidiMethod,
        on_response: Callable[[channel_pb.PutResponse], None],
        on_end: Callable[[StampedeError], None],
    ) -> None:
        super().__init__(endpoint, method, in_turn=False)
        self._on_response = on_response
        self._on_end = on_end
        threading.Thread(target=self._read, name=f"stampede acks of {self._target}", daemon=True).start()

    def send(self, request: bytes | list[bytes]) -> None:
        """Send `request`, perhaps in parts, without waiting. If the stream breaks, `on_end` gets the reason."""
        self._call.send(request)

    def _read(self) -> None:
        error: StampedeError | None = None
        try:
            for response in self._call:
                self._on_response(response)
        except grpc.RpcError as failure:
            error = from_rpc_error(failure, self._target)
        except Exception as defect:  # noqa: BLE001  # the waiting callers must get the error
            error = StampedeError(f"{self._target} sent an unexpected message: {defect!r}")
        self.cancel()
        self._on_end(error or Unavailable(f"{self._target} ended the stream"))
