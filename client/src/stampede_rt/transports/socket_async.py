"""A stream over a socket of its own, in the client on asyncio."""

from __future__ import annotations

import asyncio
import socket
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from functools import partial
from ssl import SSLError
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.transports import forking
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.socket_errors import SocketError, broken, error_of, silent
from stampede_rt.transports.socket_limits import (
    JOINED_BYTES_MAX,
    KEPT_BUFFER_BYTES_MAX,
    RECEIVE_BYTES,
    RECEIVED_BYTES_MAX,
    SILENCE_S_MAX,
    UNREAD_BYTES_MAX,
)
from stampede_rt.transports.tls_layer import TlsLayer
from stampede_rt.wire.request_pieces import SOCKET_MESSAGE_BYTES_MAX, messages_of
from stampede_rt.wire.stream_frames import FrameInBuffer, FrameKind, FrameReader, frame_of, head_of


class SocketCall(asyncio.BufferedProtocol):
    """A stream with the methods of a call of grpc.aio. It is the protocol of its connection."""

    def __init__(self, method: BidiMethod, opening: bytes, tls: TlsLayer | None = None) -> None:
        """Send the encoded opening when connected. `tls`: the TLS of the connection, after its handshake."""
        self._method, self._tls = method, tls
        self._opening = opening
        self._transport: Any = None
        self._frames = FrameReader(RECEIVED_BYTES_MAX, KEPT_BUFFER_BYTES_MAX)
        # asyncio's own way makes a new buffer for each read, which takes longer than the read
        self._buffer = memoryview(bytearray(RECEIVE_BYTES))
        self._encrypted = self._buffer if tls is None else memoryview(bytearray(RECEIVE_BYTES))
        self._received: deque[FrameInBuffer] = deque()
        self._unread_bytes = 0
        # the end of the stream; no response comes after it
        self._error: SocketError | asyncio.CancelledError | None = None
        self._is_over = self._is_full = self._is_paused = False
        self.take_in_same_turn: Callable[[Any], bool] | None = None
        """Gets a response for which the user waits, in the turn of the event loop in which the response comes.

        Returns False if it has not taken the response. The user gets that response, and any error of this function.
        """
        self._wakeup: asyncio.Future[None] | None = None
        self._room: asyncio.Future[None] | None = None
        self._done: list[Callable[[Any], object]] = []
        self._loop = asyncio.get_running_loop()
        self._last_received_s = self._loop.time()
        self._watch: asyncio.TimerHandle | None = None

    @classmethod
    async def open(
        cls, connected: socket.socket, method: BidiMethod, opening: bytes, tls: TlsLayer | None = None
    ) -> SocketCall:
        """Return a stream over a new connection."""
        forking.keep_out_of_children(connected)
        call = cls(method, opening, tls)
        try:
            await asyncio.get_running_loop().create_connection(lambda: call, sock=connected)
        except BaseException:
            connected.close()
            raise
        return call

    # --- asyncio calls these methods

    def connection_made(self, transport: Any) -> None:
        """Send the opening."""
        self._transport = transport
        transport.set_write_buffer_limits(0)
        self._send(frame_of(FrameKind.OPENING, self._opening))
        self._watch = self._loop.call_later(SILENCE_S_MAX, self._listen)

    def get_buffer(self, _sizehint: int) -> memoryview:
        """Return the place for the next bytes."""
        return self._frames.place(self._buffer) if self._tls is None else self._encrypted

    def buffer_updated(self, nbytes: int) -> None:
        """Take the received frames. While the program reads no messages, further messages wait at the host."""
        self._last_received_s = self._loop.time()
        try:
            frames = self._frames.take(self._buffer, nbytes) if self._tls is None else self._opened(self._tls, nbytes)
        except (InvalidArgument, SSLError) as error:
            self._end(broken(str(error)))
            return
        for kind, body in frames:
            if kind == FrameKind.STATUS:
                self._end(error_of(body))
                return
            if kind == FrameKind.MESSAGE and not (len(frames) == 1 and self._answer(body)):
                self._received.append((kind, body))
                self._unread_bytes += len(body)
        if self._unread_bytes > UNREAD_BYTES_MAX and not self._is_paused:
            self._is_paused = True
            self._transport.pause_reading()
        if self._received:
            _wake(self._wakeup)

    def _answer(self, body: bytes | memoryview) -> bool:
        """Let `take_in_same_turn` take a response if the user waits for one."""
        wakeup = self._wakeup
        if self.take_in_same_turn is None or self._received or wakeup is None or wakeup.done():
            return False
        try:
            return self.take_in_same_turn(self._decoded(body))
        except Exception as defect:  # noqa: BLE001  # the user gets it, as if the user had read the response
            wakeup.set_exception(defect)
            self._wakeup = wakeup = None  # the error references this frame, which must not reference the future
            return True

    def _opened(self, tls: TlsLayer, nbytes: int) -> Sequence[FrameInBuffer]:
        tls.feed(self._encrypted[:nbytes])
        frames: list[FrameInBuffer] = []
        while opened_bytes := tls.read(self._frames.place(self._buffer)):
            frames += self._frames.take(self._buffer, opened_bytes)
        return frames

    def pause_writing(self) -> None:
        """Stop writing, because the socket's buffer is full."""
        self._is_full = True

    def resume_writing(self) -> None:
        """Write again, because the system has taken all bytes."""
        self._is_full = False
        _wake(self._room)

    def connection_lost(self, error: Exception | None) -> None:
        """Note that the connection is closed."""
        self._end(broken(str(error) if error else "the host has closed it"))

    # --- the stream's user calls these methods

    async def write(self, request: Any) -> None:
        """Send a request. Returns when the system has taken it. Raises grpc.RpcError after the end of the stream."""
        encode = self._method.encode
        encoded: bytes = request if encode is None else encode(request)
        for message in messages_of(encoded, SOCKET_MESSAGE_BYTES_MAX):
            if self._is_over:
                raise self._reason() or broken("the stream has ended")
            self._send_message(message)
            while self._is_full and not self._is_over:
                self._room = self._loop.create_future()
                await self._room

    @property
    def write_now(self) -> Callable[[Any], None] | None:
        """Sends a request of one message, and does not wait. None while the system takes no bytes, and at the end."""
        return None if self._is_full or self._is_over else self._write_now

    def _write_now(self, request: Any) -> None:
        encode = self._method.encode
        self._send_message(request if encode is None else encode(request))

    def _send_message(self, message: bytes) -> None:
        if len(message) <= JOINED_BYTES_MAX:
            self._send(frame_of(FrameKind.MESSAGE, message))
        else:
            self._send(head_of(FrameKind.MESSAGE, len(message)))
            self._send(message)

    def _send(self, data: bytes) -> None:
        self._transport.write(data if self._tls is None else self._tls.encrypt((data,)))

    def __aiter__(self) -> SocketCall:
        return self

    async def __anext__(self) -> Any:
        """Return the next response. Raises grpc.RpcError, or CancelledError if this side has cancelled the stream."""
        while not self._received:
            if self._is_over:
                raise self._reason() or StopAsyncIteration
            self._wakeup = self._loop.create_future()
            await self._wakeup
        _, body = self._received.popleft()
        self._unread_bytes -= len(body)
        if self._is_paused and self._unread_bytes <= UNREAD_BYTES_MAX and not self._is_over:
            self._is_paused, self._last_received_s = False, self._loop.time()
            self._transport.resume_reading()
        return self._decoded(body)

    def _decoded(self, body: bytes | memoryview) -> Any:
        decode = self._method.decode
        return bytes(body) if decode is None else decode(body)

    def cancel(self) -> None:
        """End the stream. Messages that the program has not read are lost."""
        if not self._is_over:
            self._received.clear()
            self._end(asyncio.CancelledError())

    def add_done_callback(self, callback: Callable[[Any], object]) -> None:
        """Call `callback` with this stream at its end, or soon if the stream has already ended."""
        if self._is_over:
            self._loop.call_soon(callback, self)
        else:
            self._done.append(callback)

    def _reason(self) -> BaseException | None:
        """The reason of the end, to be raised; None for the regular end."""
        error = self._error
        return error.without_frames() if isinstance(error, SocketError) else error and asyncio.CancelledError()

    def _end(self, error: SocketError | asyncio.CancelledError | None) -> None:
        """Note the end of the stream; `error` is None if the host ended it regularly.

        Only the first call has an effect.
        """
        if self._is_over:
            return
        self._is_over, self._error, self.take_in_same_turn = True, error, None
        if self._watch is not None:
            self._watch.cancel()
        if self._transport is not None:
            self._transport.abort()
        _wake(self._wakeup)
        _wake(self._room)
        for callback in self._done:
            self._loop.call_soon(callback, self)
        self._done.clear()

    def _listen(self) -> None:
        """End the stream if the host has given no sign of life for too long."""
        silence_s = 0.0 if self._is_paused else self._loop.time() - self._last_received_s
        if silence_s >= SILENCE_S_MAX:
            self._end(silent(SILENCE_S_MAX))
        else:
            self._watch = self._loop.call_later(SILENCE_S_MAX - silence_s, self._listen)


class OpeningCall:
    """A stream whose transport is not known yet. It has the methods of a call of grpc.aio, and takes whole requests."""

    def __init__(self, opening: Awaitable[Any]) -> None:
        """`opening` returns the call. It may raise StampedeError, which `async for` then raises."""
        self._opening = asyncio.ensure_future(opening)
        self._call: Any = None
        self._is_cancelled = False
        self._opening.add_done_callback(self._opened)
        self._done: list[Callable[[Any], object]] = []

    def _opened(self, opening: asyncio.Future[Any]) -> None:
        if opening.cancelled() or opening.exception() is not None:
            for callback in self._done:
                callback(self)
            return
        self._call = opening.result()
        for callback in self._done:
            self._call.add_done_callback(callback)
        if self._is_cancelled:  # somebody called `cancel` in the turn of the loop in which the call opened
            self._call.cancel()

    async def write(self, request: Any) -> None:
        """Send a whole request, over gRPC in pieces if it is large."""
        call = self._call or await asyncio.shield(self._opening)
        for message in (request,) if isinstance(call, SocketCall) else messages_of(request):
            await call.write(message)

    async def __aiter__(self) -> AsyncIterator[Any]:
        """Yield the responses, see grpc.aio."""
        async for response in self._call or await asyncio.shield(self._opening):
            yield response

    def cancel(self) -> None:
        """End the stream."""
        self._is_cancelled = True
        if self._call is not None:
            self._call.cancel()
        else:
            self._opening.cancel()

    def add_done_callback(self, callback: Callable[[Any], object]) -> None:
        """Call `callback` with the stream at its end."""
        if self._call is not None:
            self._call.add_done_callback(callback)
        elif self._opening.done():
            asyncio.get_running_loop().call_soon(partial(callback, self))
        else:
            self._done.append(callback)


def _wake(waiting: asyncio.Future[None] | None) -> None:
    if waiting is not None and not waiting.done():
        waiting.set_result(None)
