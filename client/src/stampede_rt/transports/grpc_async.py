"""gRPC on asyncio: one `Port` for each address, with unary calls, streams and exchanges on open streams."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Any, Generic, TypeVar

import grpc
import grpc.aio

from stampede_rt.credentials import call_metadata
from stampede_rt.errors import DeadlineExceeded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.tls import TlsMaterial
from stampede_rt.transports import forking
from stampede_rt.transports.concurrency_async import when_dropped
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS, ENQUEUE_METHOD, PUT_METHOD, SILENCE_S_MAX
from stampede_rt.transports.stubs import Stubs
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb

CALLS_MAX = 1000  # of gets on one stream; hosts take 1024, and cancelled ones count until they have heard of it
Response = TypeVar("Response")
Stub = TypeVar("Stub")


def _open_channel(target: str, tls: TlsMaterial | None) -> grpc.aio.Channel:
    if tls is None:
        return grpc.aio.insecure_channel(target, options=CHANNEL_OPTIONS)
    return grpc.aio.secure_channel(target, channel_credentials(tls), options=CHANNEL_OPTIONS)


class Port(Stubs):
    """A gRPC connection to one address, shared by all calls there."""

    def __init__(self, target: str, secret: str | None, tls: TlsMaterial | None = None) -> None:
        self.target = target
        self.metadata = call_metadata(secret)
        self._channel = _open_channel(target, tls)
        super().__init__(self._channel)
        # Requests are framed by hand (wire/put_frames.py) and sent as they are.
        self._put: Callable[..., Any] = self._channel.stream_stream(
            PUT_METHOD, response_deserializer=channel_pb.PutResponse.FromString
        )
        self._enqueue: Callable[..., Any] = self._channel.stream_stream(
            ENQUEUE_METHOD, response_deserializer=queue_pb.EnqueueResponse.FromString
        )
        self._gets: list[GetExchange] = []

    def stub(self, make: Callable[[grpc.aio.Channel], Stub]) -> Stub:
        """The stub of a service that has no name here, such as `MembershipServiceStub`; its methods go to `call`."""
        return make(self._channel)

    async def call(self, method: Callable[..., Any], request: Any, timeout_s: float) -> Any:
        """One request, one response, within `timeout_s`. Raises StampedeError."""
        try:
            return await method(request, timeout=timeout_s, metadata=self.metadata)
        except grpc.RpcError as error:
            raise from_rpc_error(error, self.target) from error
        except grpc.aio.UsageError as error:
            raise closed(self.target) from error
        except asyncio.CancelledError as error:
            if _is_cancelled():
                raise
            raise closed(self.target) from error  # the call was ended by closing the connection, not this task

    def stream(self, method: Callable[..., Any], request: Any) -> Stream[Any]:
        """One request, many responses."""
        return Stream(method(request, metadata=self.metadata), self.target)

    def converse(self, method: Callable[..., Any]) -> Conversation[Any]:
        """A stream in both directions."""
        return Conversation(method(metadata=self.metadata), self.target)

    def gets(self) -> GetExchange:
        """An open stream for gets that takes one more: the first one has room for all but very many."""
        for exchange in self._gets:
            if exchange.takes_more:
                return exchange
        self._gets = [exchange for exchange in self._gets if not exchange.broken]
        exchange = GetExchange(self.channels.Get(metadata=self.metadata), self.target)
        self._gets.append(exchange)
        return exchange

    def puts(self) -> PutExchange:
        """A new stream for puts, which its caller closes."""
        return PutExchange(self._put(metadata=self.metadata), self.target)

    def enqueues(self) -> PutExchange:
        """A new stream for puts into a queue, which its caller closes."""
        return PutExchange(self._enqueue(metadata=self.metadata), self.target)

    def duplex(
        self,
        on_response: Callable[[channel_pb.PutResponse], Awaitable[None]],
        on_end: Callable[[StampedeError], Awaitable[None]],
    ) -> PutDuplex:
        """A new stream for puts that does not wait for acks: they are handed to `on_response` as they come."""
        return PutDuplex(self._put(metadata=self.metadata), self.target, on_response, on_end)

    async def aclose(self) -> None:
        """End everything that is under way here."""
        await self._channel.close(None)


def closed(target: str) -> Unavailable:
    """What a call meets whose connection is closed meanwhile."""
    return Unavailable(f"the connection to {target} is closed")


def silent(target: str) -> Unavailable:
    """What a stream meets that gives no sign of life."""
    return Unavailable(f"{target} was silent for {SILENCE_S_MAX:g} s; it may be stopped")


def _is_cancelled() -> bool:
    """Whether this task is to end; if not, it was its call that somebody cancelled."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


async def _give_up(call: Any) -> None:
    call.cancel()


class Stream(Generic[Response]):
    """The responses of one request. `cancel` may be called from anywhere and ends the iteration."""

    def __init__(self, call: Any, target: str) -> None:
        self._call = call
        self._target = target
        self._forks = forking.forks()
        self._cancelled = False
        when_dropped(self, partial(_give_up, call))

    async def __aiter__(self) -> AsyncIterator[Response]:
        responses = aiter(self._call)
        try:
            while True:
                async with asyncio.timeout(SILENCE_S_MAX):
                    response = await anext(responses)
                yield response
        except StopAsyncIteration:
            pass
        except TimeoutError:
            self._call.cancel()
            raise silent(self._target) from None
        except grpc.RpcError as error:
            if not self._cancelled:
                raise from_rpc_error(error, self._target) from error
        except asyncio.CancelledError:
            if not self._cancelled and _is_cancelled():
                self._call.cancel()
                raise
            if not self._cancelled:
                raise closed(self._target) from None
        if not self._cancelled:
            raise Unavailable(f"{self._target} ended the stream")

    def cancel(self) -> None:
        """Give the stream up."""
        self._cancelled = True
        if self._forks == forking.forks():
            self._call.cancel()


class Conversation(Stream[Response]):
    """A stream in both directions: `say` sends, the iteration gives what comes."""

    def __init__(self, call: Any, target: str) -> None:
        super().__init__(call, target)
        self._writing = asyncio.Lock()

    async def say(self, request: Any) -> None:
        """Send `request`; blocks while the connection's window is full. Raises Unavailable if the stream is broken."""
        try:
            async with self._writing:
                await self._call.write(request)
        except (grpc.RpcError, asyncio.InvalidStateError) as error:
            raise Unavailable(f"the stream to {self._target} is broken") from error


class _Exchange:
    """An open bidirectional stream with a task that reads its responses."""

    def __init__(self, call: Any, target: str) -> None:
        self._call = call
        self._target = target
        self._forks = forking.forks()
        self._writing = asyncio.Lock()
        self._reader = asyncio.create_task(self._read())
        self.broken = False

    async def _write(self, request: Any) -> None:
        try:
            async with self._writing:
                await self._call.write(request)
        except (grpc.RpcError, asyncio.InvalidStateError) as error:
            self.broken = True
            if asyncio.current_task() is not self._reader:  # which writes, too, where an ack makes room
                await self._reader  # it ends with the reason, and hands it to all that wait
            raise Unavailable(f"the stream to {self._target} is broken") from error

    async def _read(self) -> None:
        error: StampedeError = Unavailable(f"{self._target} ended the stream")
        try:
            async for response in self._call:
                await self._receive(response)
        except grpc.RpcError as failure:
            error = from_rpc_error(failure, self._target)
        except asyncio.CancelledError:
            error = Unavailable(f"the connection to {self._target} is closed")
        self.broken = True
        await self._end(error)

    async def _receive(self, response: Any) -> None:
        raise NotImplementedError

    async def _end(self, error: StampedeError) -> None:
        raise NotImplementedError

    def cancel(self) -> None:
        """Give the stream up."""
        self.broken = True
        if self._forks == forking.forks():
            self._call.cancel()


async def _within(future: asyncio.Future[Response], timeout_s: float | None, target: str) -> Response:
    try:
        async with asyncio.timeout(timeout_s):
            return await future
    except TimeoutError:
        raise DeadlineExceeded(f"{target} did not answer within {timeout_s:g} s; it may be overloaded") from None


class GetExchange(_Exchange):
    """Gets on one open stream: CALLS_MAX may be under way, told apart by their call ids."""

    def __init__(self, call: Any, target: str) -> None:
        self._waiting: dict[int, tuple[asyncio.Future[list[channel_pb.GetResponse]], list[channel_pb.GetResponse]]] = {}
        self._next_id = 0
        self._farewell: asyncio.Task[None] | None = None  # held, so that it is not collected before it is done
        super().__init__(call, target)

    @property
    def takes_more(self) -> bool:
        """It is open, and the host takes another call on it."""
        return not self.broken and len(self._waiting) < CALLS_MAX

    async def get(self, request: channel_pb.GetRequest, timeout_s: float | None) -> list[channel_pb.GetResponse]:
        """All responses to `request`, which gets a call id here. Cancelling the task cancels the call at the host."""
        self._next_id += 1
        request.call_id = call_id = self._next_id
        future: asyncio.Future[list[channel_pb.GetResponse]] = asyncio.get_running_loop().create_future()
        self._waiting[call_id] = (future, [])
        try:
            await self._write(request)
            return await _within(future, timeout_s, self._target)
        except (asyncio.CancelledError, DeadlineExceeded):
            self._give_up(call_id)
            raise
        finally:
            self._waiting.pop(call_id, None)
            if future.done() and not future.cancelled():
                future.exception()  # seen, also when the write already failed

    def _give_up(self, call_id: int) -> None:
        if not self.broken:
            self._farewell = asyncio.ensure_future(self._cancel_call(call_id))

    async def _cancel_call(self, call_id: int) -> None:
        """Tell the host. On a stream that breaks meanwhile it has heard."""
        with suppress(StampedeError):
            await self._write(channel_pb.GetRequest(call_id=call_id, cancel=True))

    async def _receive(self, response: channel_pb.GetResponse) -> None:
        entry = self._waiting.get(response.call_id)
        if entry is None:  # given up meanwhile
            return
        future, responses = entry
        responses.append(response)
        if (response.HasField("summary") or response.HasField("error")) and not future.done():
            future.set_result(responses)

    async def _end(self, error: StampedeError) -> None:
        for future, _ in self._waiting.values():
            if not future.done():
                future.set_exception(error)


class PutExchange(_Exchange):
    """Puts on one open stream, each awaiting its ack; acks come in the order of the puts."""

    def __init__(self, call: Any, target: str) -> None:
        self._waiting: deque[asyncio.Future[channel_pb.PutAck]] = deque()
        super().__init__(call, target)

    async def put(self, request: bytes, timeout_s: float | None) -> channel_pb.PutAck:
        """The ack of the one run in `request`."""
        future: asyncio.Future[channel_pb.PutAck] = asyncio.get_running_loop().create_future()
        try:
            async with self._writing:
                self._waiting.append(future)
                await self._call.write(request)
        except (grpc.RpcError, asyncio.InvalidStateError):
            self.broken = True
            await self._reader
            if not future.done():  # it joined those that wait when the reader had ended
                future.set_exception(Unavailable(f"the stream to {self._target} is broken"))
        except asyncio.CancelledError as error:
            if not _is_cancelled():
                self.broken = True
                raise closed(self._target) from error
            self.cancel()  # the ack that would come for nobody could be taken for another's
            raise
        return await _within(future, timeout_s, self._target)

    async def _receive(self, response: channel_pb.PutResponse) -> None:
        for ack in response.acks:
            future = self._waiting.popleft()
            if not future.done():
                future.set_result(ack)

    async def _end(self, error: StampedeError) -> None:
        while self._waiting:
            future = self._waiting.popleft()
            if not future.done():
                future.set_exception(error)


class PutDuplex(_Exchange):
    """Puts on one open stream whose acks are handed on as they come."""

    def __init__(
        self,
        call: Any,
        target: str,
        on_response: Callable[[channel_pb.PutResponse], Awaitable[None]],
        on_end: Callable[[StampedeError], Awaitable[None]],
    ) -> None:
        self._on_response = on_response
        self._on_end = on_end
        super().__init__(call, target)

    async def write(self, request: bytes) -> None:
        """Send `request`; blocks while the connection's window is full. Raises Unavailable."""
        await self._write(request)

    async def _receive(self, response: channel_pb.PutResponse) -> None:
        await self._on_response(response)

    async def _end(self, error: StampedeError) -> None:
        await self._on_end(error)
