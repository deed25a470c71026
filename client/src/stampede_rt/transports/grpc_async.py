"""gRPC on asyncio. A `ServerEndpoint` makes unary calls, streams, and exchanges on open streams at one address."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar
from weakref import WeakSet

import grpc
import grpc.aio

from stampede_rt.cluster.call_metadata import CallMetadata
from stampede_rt.cluster.request_age import age_metadata
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import DeadlineExceeded, StampedeError
from stampede_rt.security.tls import TlsMaterial
from stampede_rt.status import raise_from_rpc_error
from stampede_rt.transports.bidi_methods import BidiMethod, BidiMethods
from stampede_rt.transports.call_stream_async import CallStream, fail, within
from stampede_rt.transports.concurrency_async import in_thread
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS, END_TIMEOUT_S, ENQUEUE_METHOD, PUT_METHOD
from stampede_rt.transports.machine import this_machine
from stampede_rt.transports.ring_mapping import RingMapping, receive_ring
from stampede_rt.transports.socket_async import OpeningCall, SocketCall
from stampede_rt.transports.socket_connecting_async import connect
from stampede_rt.transports.socket_limits import CONNECT_S_MAX
from stampede_rt.transports.socket_routes import SocketRoute, opening_of
from stampede_rt.transports.streams_async import BidiStream, ServerStream, closed, is_cancelled
from stampede_rt.transports.stubs import Stubs
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.delivered import ItemCount

# The gets on one stream at the same time. A host takes 1024. This number is lower, because a host counts a cancelled
# get until it learns of the cancellation.
CALLS_MAX = 1000

Stub = TypeVar("Stub")


def _open_channel(target: str, tls: TlsMaterial | None) -> grpc.aio.Channel:
    if tls is None:
        return grpc.aio.insecure_channel(target, options=CHANNEL_OPTIONS)
    return grpc.aio.secure_channel(target, channel_credentials(tls), options=CHANNEL_OPTIONS)


class ServerEndpoint(Stubs):
    """A gRPC connection to one address. All calls to this address share it."""

    is_stuck = False  # no interrupt can leave a lock of gRPC locked here, as it can in the blocking client

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
        self._gets: list[GetExchange] = []
        self._tasks: set[asyncio.Task[None]] = set()  # the tasks of all streams
        self._socket_calls: WeakSet[Any] = WeakSet()
        self._is_closed = False

    def stub(self, make: Callable[[grpc.aio.Channel], Stub]) -> Stub:
        """Return the stub of a service that has no attribute here, such as `MembershipServiceStub`.

        Pass its methods to `call`.
        """
        return make(self._channel)

    async def call(self, method: Callable[..., Any], request: Any, timeout_s: float, age_s: float = 0.0) -> Any:
        """Make one call, within `timeout_s`. Raises StampedeError.

        `age_s`: the seconds since the client first sent this update.
        """
        try:
            return await method(request, timeout=timeout_s, metadata=self._metadata() + age_metadata(age_s))
        except grpc.RpcError as error:
            raise_from_rpc_error(error, self.target)
        except grpc.aio.UsageError as error:
            raise closed(self.target) from error
        except asyncio.CancelledError as error:
            if is_cancelled():
                raise
            raise closed(self.target) from error  # the connection was closed, and this task was not cancelled

    def stream(self, method: Callable[..., Any], request: Any) -> ServerStream[Any]:
        """Open a stream of responses to one request."""
        return ServerStream(self._begin(method, request), self.target)

    def open_bidi(self, method: BidiMethod) -> BidiStream[Any]:
        """Open a stream in both directions."""
        return BidiStream(self._begin_bidi(method), self.target, self._tasks)

    def open_read_bidi(self, method: BidiMethod) -> BidiStream[Any]:
        """Like `open_bidi`. The blocking client has a faster stream here, for calls that read after they have sent."""
        return self.open_bidi(method)

    def gets(self) -> GetExchange:
        """Return an open stream that takes one more get. It is nearly always the first stream."""
        for exchange in self._gets:
            if exchange.is_outdated:
                exchange.end_if_idle()
            elif exchange.takes_more:
                return exchange
        self._gets = [exchange for exchange in self._gets if not exchange.broken]
        exchange = GetExchange(self._begin_bidi(self.channels.Get), self.target, self._tasks, self.route)
        self._gets.append(exchange)
        return exchange

    def puts(self) -> PutExchange:
        """Open a stream for puts. The caller closes it."""
        return PutExchange(self._begin_bidi(self._put), self.target, self._tasks, self.route)

    def enqueues(self) -> PutExchange:
        """Open a stream for puts into a queue. The caller closes it."""
        return PutExchange(self._begin_bidi(self._enqueue), self.target, self._tasks, self.route)

    def duplex(
        self,
        on_response: Callable[[channel_pb.PutResponse], Awaitable[None]],
        on_end: Callable[[StampedeError], Awaitable[None]],
    ) -> PutDuplex:
        """Open a stream whose puts do not wait for their acks. The stream passes each response to `on_response`."""
        return PutDuplex(self._begin_bidi(self._put), self.target, self._tasks, self.route, on_response, on_end)

    def _begin_bidi(self, method: BidiMethod) -> Any:
        """Begin the call of a stream in both directions. Raises Unavailable when this endpoint is closed."""
        if not self.route.may_lead:
            return self._begin(method)
        if self._is_closed:
            raise closed(self.target)
        call = OpeningCall(self._open_bidi(method))
        self._socket_calls.add(call)
        return call

    async def transport(self) -> str:
        """Return the transport of new streams in both directions. Connects to find out, so it may take 2 s.

        Raises Unavailable if the program has chosen sockets, and none can be used.
        """
        connected = await connect(self.route, self._ask_for_sockets)
        if connected is None:
            return Transport.GRPC.value
        connected.close()
        return (Transport.SOCKET if connected.is_local else Transport.TCP).value

    async def share_memory(self, channel_id: bytes, epoch: int) -> RingMapping | None:
        """Return the ring of a channel; None if this host shares no memory. Takes at most 4 s, see `receive_ring`."""
        connected = await connect(self.route, self._ask_for_sockets)
        receive = partial(receive_ring, self.route, connected, self._metadata(), channel_id, epoch)
        receiving = asyncio.ensure_future(in_thread(receive))
        try:
            return await asyncio.shield(receiving)
        except asyncio.CancelledError:  # the thread continues, and no other code would close its ring
            receiving.add_done_callback(_close_unwanted)
            raise

    async def _open_bidi(self, method: BidiMethod) -> Any:
        connected = await connect(self.route, self._ask_for_sockets)
        if connected is None:
            return self._begin(method)
        opening = opening_of(method.name, self._metadata(), self.route.ticket if connected.is_local else b"")
        return await SocketCall.open(connected.socket, method, opening, connected.tls)

    async def _ask_for_sockets(self) -> Sequence[gatekeeper_pb.DataEndpoint]:
        request = gatekeeper_pb.ListDataEndpointsRequest(machine=this_machine())
        response = await self.call(self.gatekeeper.ListDataEndpoints, request, CONNECT_S_MAX)
        endpoints: Sequence[gatekeeper_pb.DataEndpoint] = response.endpoints
        return endpoints

    def _begin(self, method: Callable[..., Any], *request: Any) -> Any:
        """Begin the call of a stream. Raises Unavailable when this endpoint is closed."""
        try:
            return method(*request, metadata=self._metadata())
        except grpc.aio.UsageError as error:
            raise closed(self.target) from error

    async def aclose(self) -> None:
        """End all calls and streams, without waiting for them. `ended` waits."""
        self._is_closed = True
        if self.route.tcp.reaching is not None:
            self.route.tcp.reaching.cancel()
        for call in tuple(self._socket_calls):
            call.cancel()
        await self._channel.close(None)

    async def ended(self) -> None:
        """Wait for the tasks of all streams, at most END_TIMEOUT_S. The tasks end soon after `aclose`."""
        tasks = self._tasks - {asyncio.current_task()}
        if tasks:
            await asyncio.wait(tasks, timeout=END_TIMEOUT_S)


class _WaitingGet(NamedTuple):
    """A get that waits for the rest of its answer."""

    future: asyncio.Future[list[channel_pb.GetResponse]]
    responses: list[channel_pb.GetResponse]
    received: ItemCount


class GetExchange(CallStream):
    """Gets on one open stream, at most CALLS_MAX at the same time, each with a call id."""

    def __init__(self, call: Any, target: str, tasks: set[asyncio.Task[None]], route: SocketRoute) -> None:
        self._waiting: dict[int, _WaitingGet] = {}
        self._next_id = 0
        super().__init__(call, target, tasks, route)

    @property
    def takes_more(self) -> bool:
        """Whether the stream is open and takes another call."""
        return not self.broken and len(self._waiting) < CALLS_MAX

    def end_if_idle(self) -> None:
        """End the stream unless a get waits on it."""
        if not self._waiting:
            self.cancel()

    async def get(self, request: channel_pb.GetRequest, timeout_s: float | None) -> list[channel_pb.GetResponse]:
        """Give `request` a call id, send it, and return all responses.

        Waits for at most `timeout_s` seconds; None: without limit. Raises StampedeError, DeadlineExceeded after
        `timeout_s`. If the get ends early, for example because the task is cancelled, the client asks the host to
        cancel it.
        """
        if self.broken:
            raise closed(self._target)
        self._next_id += 1
        request.call_id = call_id = self._next_id
        future: asyncio.Future[list[channel_pb.GetResponse]] = asyncio.get_running_loop().create_future()
        self._waiting[call_id] = _WaitingGet(future, [], ItemCount(request.limit))
        number = self._requests.send(request)
        try:
            return await within(future, timeout_s, self._target)
        except (asyncio.CancelledError, DeadlineExceeded):
            if not self._requests.withdraw(number):  # the host may have the request
                self._requests.send(channel_pb.GetRequest(call_id=call_id, cancel=True))
            raise
        finally:
            self._waiting.pop(call_id, None)

    async def _receive(self, response: channel_pb.GetResponse) -> None:
        entry = self._waiting.get(response.call_id)
        if entry is None:  # the caller of the get gave up
            return
        entry.received.add(one.run for one in response.runs)  # an error ends the stream, and all gets on it
        entry.responses.append(response)
        if (response.HasField("summary") or response.HasField("error")) and not entry.future.done():
            entry.future.set_result(entry.responses)

    async def _end(self, error: StampedeError) -> None:
        for entry in self._waiting.values():
            fail(entry.future, error)


class PutExchange(CallStream):
    """Puts on one open stream. The acks come in the order of the puts.

    If the caller of a put gave up, the put may still wait for room at the host. The stream then takes no new put, and
    ends after its last waiting put.
    """

    one_at_a_time = False
    """Whether a stream has at most one put under way."""

    def __init__(self, call: Any, target: str, tasks: set[asyncio.Task[None]], route: SocketRoute) -> None:
        self._waiting: deque[asyncio.Future[channel_pb.PutAck]] = deque()
        super().__init__(call, target, tasks, route)

    async def put(self, request: bytes, timeout_s: float | None, *, survives_cancel: bool = False) -> channel_pb.PutAck:
        """Send the run in `request`, and return its ack. `timeout_s` and the errors are as in `GetExchange.get`.

        `survives_cancel`: the stream continues if the task is cancelled, because the put waits for no room.
        """
        if self.broken:
            raise closed(self._target)
        future: asyncio.Future[channel_pb.PutAck] = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        self._requests.send(request)
        try:
            return await within(future, timeout_s, self._target)
        except (asyncio.CancelledError, DeadlineExceeded) as reason:
            stays_usable = (
                survives_cancel and isinstance(reason, asyncio.CancelledError) and len(self._waiting) <= CALLS_MAX
            )
            self.broken = self.broken or not stays_usable
            self._end_if_idle()
            raise

    def _end_if_idle(self) -> None:
        if self.broken and all(future.done() for future in self._waiting):
            self.cancel()

    async def _receive(self, response: channel_pb.PutResponse) -> None:
        for ack in response.acks:
            future = self._waiting.popleft()
            if not future.done():
                future.set_result(ack)
        self._end_if_idle()

    async def _end(self, error: StampedeError) -> None:
        while self._waiting:
            fail(self._waiting.popleft(), error)


class PutDuplex(CallStream):
    """Puts on one open stream. It passes each response to `on_response`, and calls `on_end` once at the end."""

    def __init__(
        self,
        call: Any,
        target: str,
        tasks: set[asyncio.Task[None]],
        route: SocketRoute,
        on_response: Callable[[channel_pb.PutResponse], Awaitable[None]],
        on_end: Callable[[StampedeError], Awaitable[None]],
    ) -> None:
        self._on_response = on_response
        self._on_end = on_end
        super().__init__(call, target, tasks, route)

    def send(self, request: bytes | list[bytes]) -> None:
        """Send `request`, perhaps in parts, without waiting. If the stream breaks, `on_end` gets the reason."""
        self._requests.send(request)

    async def _receive(self, response: channel_pb.PutResponse) -> None:
        await self._on_response(response)

    async def _end(self, error: StampedeError) -> None:
        await self._on_end(error)


def _close_unwanted(received: asyncio.Future[RingMapping | None]) -> None:
    if not received.cancelled() and received.exception() is None and (mapping := received.result()) is not None:
        mapping.close()
