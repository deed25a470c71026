"""Connections and calls between hosts in virtual time. The generated stubs use them like connections of gRPC."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Container, Iterable
from typing import Any, NamedTuple

import grpc
from google.protobuf.message import Message
from grpc.aio import EOF

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.status import abort
from stampede_rt_runtime.sockets.dialing import HostStream
from tests.robustness.moves.links import arrived
from tests.robustness.moves.two_hosts import Host
from tests.robustness.takeovers.world import Cluster


class Method(NamedTuple):
    """A method of a host. `parse` decodes a request; None: the method takes encoded requests."""

    serve: Callable[[Any], Awaitable[None]]
    parse: Callable[[bytes], Any] | None = None


class Connection:
    """A connection to a host. `caller` None: a client calls. `methods`: the methods of the host, by path.

    The streams of the methods `over_sockets` write as if over a socket: in the turn of the event loop, without a wait.
    """

    def __init__(
        self, cluster: Cluster, host: Host, methods: dict[str, Method], caller: Host | None = None,
        over_sockets: Container[str] = (),
    ) -> None:  # fmt: skip
        self._cluster, self._host, self._methods, self._caller = cluster, host, methods, caller
        self._over_sockets = over_sockets

    def stream_stream(
        self, path: str, request_serializer: Callable[[Any], bytes] = bytes,
        response_deserializer: Callable[[bytes], Any] = bytes, **_: Any,
    ) -> Callable[..., Call]:  # fmt: skip
        def call(requests: Iterable[Any] | None = None, **_: Any) -> Call:
            method, kind = self._methods[path], SocketStream if path in self._over_sockets else Call
            made = kind(self._cluster, self._host, self._caller, method, request_serializer, response_deserializer)
            if requests is not None:
                made.send_all(requests)
            return made

        return call

    def unary_unary(self, path: str, **_: Any) -> None:
        """The generated stubs ask for all methods. The simulator plays only streams."""

    unary_stream = stream_unary = unary_unary

    async def close(self, grace: float | None) -> None:
        """Calls end on their own."""


class Call:
    """One call, at its caller. `sent_s`: the time at which the host began to send the last message that was read."""

    sent_s = 0.0

    def __init__(
        self, cluster: Cluster, host: Host, caller: Host | None, method: Method, encode: Callable[[Any], bytes],
        decode: Callable[[bytes], Any],
    ) -> None:  # fmt: skip
        self.cluster, self.source, self.caller = cluster, host, caller
        self.method = method
        self.to_host: asyncio.Queue[Any] = asyncio.Queue()
        self._to_caller: asyncio.Queue[Any] = asyncio.Queue()
        self._encode, self._decode = encode, decode
        self._serving: asyncio.Task[None] | None = None
        self._end: object = None  # the caller reads this from now on

    def due_s(self) -> float:
        """The time of arrival of a message that is sent now."""
        return self.cluster.clock.now_s + self.cluster.delay_s(self)

    def cut(self) -> None:
        """Break the call: the host's handler is cancelled, and the caller reads an error."""
        self.cancel()
        self._to_caller.put_nowait((0.0, (0.0, Unavailable("the connection is cut"))))

    def cancel(self) -> None:
        """End the call, as its caller does."""
        if self._serving is not None:
            self._serving.cancel()

    # The caller's side.

    async def write(self, message: Any) -> None:
        await self._while_running()
        if self._end is not None or (self._serving is not None and self._serving.done()):
            raise asyncio.InvalidStateError("the call has ended")
        self._put(self._encode(message))
        await asyncio.sleep(0)

    def send_all(self, requests: Iterable[Any]) -> None:
        """Send all requests, and end the caller's side."""
        for one in requests:
            self._put(self._encode(one))
        self._put(EOF)

    async def done_writing(self) -> None:
        self._put(EOF)

    def _put(self, message: object) -> None:
        if self._serving is None:
            if not self.source.alive or not self.cluster.reaches(self):
                raise Unavailable("the host does not answer")
            self.cluster.links.append(self)
            self._serving = asyncio.create_task(self._serve())
        self.cluster.passes(self)
        self.to_host.put_nowait((self.due_s(), message))

    async def _while_running(self) -> None:
        if self.caller is not None:
            await self.caller.running.wait()

    async def read(self) -> Any:
        if self._end is None:
            self.sent_s, found = await arrived(self._to_caller)
            await self._while_running()
            if isinstance(found, bytes):
                return self._decode(found)
            self._end = found
        if isinstance(self._end, StampedeError | grpc.RpcError):
            raise self._end
        return EOF

    async def __aiter__(self) -> AsyncIterator[Any]:
        while (response := await self.read()) is not EOF:
            yield response

    # The host's side.

    def answer(self, message: object, sent_s: float = 0.0) -> None:
        """Send something to the caller. `sent_s`: the time at which the host began to send it."""
        self.cluster.passes(self)
        self._to_caller.put_nowait((self.due_s(), (sent_s, message)))

    async def _serve(self) -> None:
        context = Context(self)
        try:
            await self.method.serve(context)
        except StampedeError as error:
            await abort(context, error)
        except Exception as error:  # noqa: BLE001 - a defect, which fails the run
            self.cluster.defects.append(error)
        finally:
            self.cluster.links.remove(self)
            self.answer(EOF)


class SocketStream(Call, HostStream):
    """A call over a socket, at its caller. Its answers come as over gRPC."""

    @property
    def write_now(self) -> Callable[[Any], None] | None:
        is_over = self._end is not None or self._serving is None or self._serving.done()
        if is_over or self.caller is None or not self.caller.running.is_set():
            return None
        return lambda message: self._put(self._encode(message))

    def answer_in_same_turn(self, take: Callable[[Any], bool]) -> None:
        pass


class Context:
    """One call, as gRPC shows it to the host's handler."""

    def __init__(self, call: Call) -> None:
        self._call = call

    def auth_context(self) -> dict[str, Any]:
        return {}

    async def read(self) -> Any:
        request = await arrived(self._call.to_host)
        await self._call.source.running.wait()
        if request is EOF or self._call.method.parse is None:
            return request
        return self._call.method.parse(request)

    async def write(self, message: Message | bytes) -> None:
        call, sent_s = self._call, self._call.cluster.clock.now_s
        await call.source.running.wait()
        encoded = message if isinstance(message, bytes) else message.SerializeToString()
        call.answer(encoded, sent_s)
        await asyncio.sleep(0)

    async def abort(self, code: grpc.StatusCode, details: str, trailing: Any = ()) -> None:
        metadata = grpc.aio.Metadata.from_tuple(tuple(trailing))
        self._call.answer(grpc.aio.AioRpcError(code, grpc.aio.Metadata(), metadata, details))
        raise asyncio.CancelledError
