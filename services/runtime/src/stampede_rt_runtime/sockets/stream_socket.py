"""A stream over a socket of its own. It has the limits of a stream of the gRPC server."""

from __future__ import annotations

import asyncio
import os
import socket
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from grpc.aio import EOF, InternalError

from stampede_rt.errors import DeadlineExceeded, InvalidArgument, StampedeError
from stampede_rt.wire.stream_frames import OPENING_BYTES_MAX, FrameKind, FrameReader, frame_of, head_of
from stampede_rt_runtime.access.control import current_account
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.quotas.subjects import machine_of
from stampede_rt_runtime.sockets.frame_buffers import SHORT_BYTES, FrameBuffers, FramePlace
from stampede_rt_runtime.sockets.hangups import HangupWatcher
from stampede_rt_runtime.sockets.openings import opening_in, unfinished, unread_by_peer
from stampede_rt_runtime.sockets.socket_owner import SocketOwner
from stampede_rt_runtime.sockets.tickets import CertificateFacts

FRAME_SECONDS_MAX = 11.0  # from the first byte of a frame to its last one, while the service reads
STALL_SECONDS_MAX = 30.0  # the longest time for which a peer may take no bytes from the service
LINGER_SECONDS = 2.0  # the time that a peer has to read the status after the end of its stream
_MESSAGE_OVERHEAD_BYTES = 64  # the memory of a waiting message, without its bytes
_JOINED_BYTES_MAX = 2**16  # up to this length a copy of a message takes less time than a second system call

LOCAL_PEER = "unix:"
ALIVE = frame_of(FrameKind.ALIVE)

Write = Callable[[bytes], None]
TakeInSameTurn = Callable[[bytes | memoryview, Write], bool]
"""Takes a message and writes the response in the same turn of the event loop. Returns False if it has not taken it.

It must keep no view of the message: another message overwrites it.
"""


class StreamSocket(asyncio.BufferedProtocol):
    """Reads and writes the frames of one stream."""

    def __init__(
        self, owner: SocketOwner[StreamSocket], limits: Limits, hangups: HangupWatcher, buffers: FrameBuffers,
        peer: str = LOCAL_PEER,
    ) -> None:  # fmt: skip
        """`peer`: the other side, as gRPC names it."""
        self.socket: Any = None
        self.peer, self.is_local, self.machine = peer, peer == LOCAL_PEER, machine_of(peer)
        self.certificate: CertificateFacts = {}
        """The certificate of the connection; nothing without TLS."""
        self.is_opened = False
        self.is_over = False
        """Whether the status was written."""
        self.take_in_same_turn: TakeInSameTurn | None = None
        """Gets each message for which `read` waits. If it does not take the message, `read` returns the message."""
        self._owner, self._limits, self._hangups, self._buffers = owner, limits, hangups, buffers
        self._transport: Any = None
        opening, message = FrameKind.OPENING, FrameKind.MESSAGE
        bytes_max = {opening: OPENING_BYTES_MAX, message: limits.socket_request_bytes_max, FrameKind.END: 0}
        self._frames = FrameReader(bytes_max, new_buffer=buffers.take_buffer)
        self._loop = asyncio.get_running_loop()
        self._deadline: asyncio.TimerHandle | None = None
        self._messages: deque[bytes] = deque()
        self._unread_bytes = 0
        self._waiter: asyncio.Future[None] | None = None
        self._has_ended = self._is_lost = self._is_paused = self._has_written = self._is_full = False
        self._room: asyncio.Future[None] | None = None
        self._frame_since_s: float | None = None
        self._place: FramePlace | None = None  # None before the first read
        self._is_filling = False  # Whether a long frame that has a place is being read.
        self._stalled_since_s, self._stalled_bytes = 0.0, 0

    # --- asyncio calls these methods

    def connection_made(self, transport: Any) -> None:
        """Wait for the opening, for a limited time."""
        self._transport, self.socket = transport, transport.get_extra_info("socket")
        transport.set_write_buffer_limits(0)
        if not self.is_local:
            self._write(ALIVE)  # the greeting: the caller learns that this host has the connection
        opening_s = self._limits.handshake_millis_max / 1000
        self._deadline = self._loop.call_later(opening_s, self._opening_overdue, opening_s)

    def get_buffer(self, _sizehint: int) -> memoryview:
        """The memory for the next bytes. All connections share one buffer, except for long frames."""
        return self._frames.buffer() if self._is_filling else self._buffers.short

    def buffer_updated(self, received_bytes: int) -> None:
        """Take the received frames. Bytes after the stream's end are dropped."""
        if self.is_over:
            return
        try:
            is_whole = self._fill(received_bytes) if self._is_filling else self._feed(received_bytes)
        except StampedeError as error:
            self._owner.failed(self, error)
            return
        if not self._frames.unfinished_bytes:
            self._frame_since_s = None
        elif not self._is_paused and (is_whole or self._frame_since_s is None):
            self._frame_since_s = self._loop.time()
        if self._must_wait_for_place():
            self._pause()
            _wake(self._waiter)  # `read` takes the place
        elif self._unread_bytes > self._limits.unread_bytes_max:
            self._pause()

    def _feed(self, received_bytes: int) -> bool:
        """Take bytes of the short memory. Returns whether a frame is complete."""
        whole = self._frames.feed(self._buffers.short[:received_bytes])
        if len(whole) != 1 or not self._answer(*whole[0]):
            for kind, body in whole:
                self._take(kind, body)
        return bool(whole)

    def _fill(self, received_bytes: int) -> bool:
        """Take bytes of a long frame. Returns whether it is complete. Copies it only if it must wait."""
        frame = self._frames.filled_buffer(received_bytes)
        if frame is None:
            return False
        self._leave_place()
        kind, body = frame
        buffer = body.obj
        assert isinstance(buffer, bytearray), "see `FrameBuffers.buffer`"
        if not self._answer(kind, body):
            self._take(kind, bytes(body))
        del frame, body
        self._buffers.give_back(buffer)
        return True

    def _must_wait_for_place(self) -> bool:
        """Whether a long frame has begun that must wait for a place. If it need not wait, it takes its place now."""
        if self._is_filling or self._frames.missing_bytes <= SHORT_BYTES or not self.is_opened:
            return False
        self._is_filling = self._place is not None and self._place.take_now(self._frames.wanted_bytes)
        return not self._is_filling

    def _leave_place(self, lost_bytes: int = 0) -> None:
        if self._is_filling:
            assert self._place is not None, "a stream that fills a frame has a place"
            self._is_filling = False
            self._place.leave(lost_bytes)

    def pause_writing(self) -> None:
        """Stop writing, because the system takes no more bytes."""
        self._is_full = True

    def resume_writing(self) -> None:
        """Write again, because the system has taken all bytes."""
        self._is_full = False
        _wake(self._room)

    def eof_received(self) -> bool:
        """Close the connection, because the peer has gone. Connections whose peers have gone earlier close first."""
        self._hangups.close_soon(self._transport.close)
        return True  # asyncio must not close it now: thousands may end in one turn of the loop

    def connection_lost(self, error: Exception | None) -> None:
        """Note that the peer has gone, or that the connection was closed here."""
        self._is_lost = self._has_ended = True
        self.take_in_same_turn = None  # it refers to the method, and the method refers to this connection
        self._hangups.forget(self.socket)
        self._drop_frame()
        if self._deadline is not None:
            self._deadline.cancel()
        if error is None:
            self._end_stream()
        else:  # thousands of connections may break in one turn of the loop
            self._hangups.close_soon(self._end_stream)

    def _end_stream(self) -> None:
        _wake(self._waiter)
        _wake(self._room)
        self._owner.lost(self)

    # --- the stream's user calls these methods

    async def read(self) -> Any:
        """The next message, or EOF."""
        if self._place is None:
            self._place = self._buffers.place(current_account())
        while not self._messages:
            if self._has_ended:
                return EOF
            if self._must_wait_for_place():
                self._pause()  # reading may have resumed when an earlier message was read
                await self._place.take(self._frames.wanted_bytes)
                self._is_filling = True
                if self._is_lost:
                    self._drop_frame()
            self._resume()
            self._waiter = self._loop.create_future()
            await self._waiter
        message = self._messages.popleft()
        self._unread_bytes -= len(message) + _MESSAGE_OVERHEAD_BYTES
        if self._unread_bytes <= self._limits.unread_bytes_max:
            self._resume()
        return message

    async def write(self, message: bytes | Sequence[bytes]) -> None:
        """Write a message or its parts. Returns when the system has taken it. Raises InternalError if the peer left."""
        if self.is_over or self._is_closing:
            raise InternalError("the stream has ended")
        self._write_message(message)
        while self._is_full and not self._is_lost:
            self._room = self._loop.create_future()
            await self._room
        if self._is_lost:
            raise InternalError("the caller has closed its socket")

    @property
    def write_now(self) -> Write | None:
        """Writes a message, and does not wait. None while the system takes no bytes, and after the end."""
        return None if self._is_full or self.is_over or self._is_closing else self._write_message

    def write_with_file(self, message: bytes, file: int) -> None:
        """Write a short message, and pass an open file with it. `file` is the file's descriptor. Does not wait.

        The peer gets a descriptor of its own. Raises InternalError if the peer has gone, or takes nothing at present.
        """
        if not self.is_local or self.is_over or self._is_closing or self._transport.get_write_buffer_size():
            raise InternalError("the stream has ended, or its caller takes nothing, or is at another machine")
        frame = frame_of(FrameKind.MESSAGE, message)
        try:
            with socket.socket(fileno=os.dup(self.socket.fileno())) as own:
                own.setblocking(False)
                sent_bytes = socket.send_fds(own, [frame], [file])
        except OSError as error:
            raise InternalError(f"the caller takes nothing: {error}") from error
        self._has_written = True
        if sent_bytes < len(frame):
            self._transport.write(frame[sent_bytes:])

    def end(self, status: bytes) -> None:
        """Write the status, and close the connection when the peer has read it. Only the first status counts."""
        if self.is_over:
            return
        self.is_over = True
        self._messages.clear()
        self._drop_frame()
        if self._is_closing:
            return
        if not self._is_full:  # otherwise the peer reads nothing
            self._write(frame_of(FrameKind.STATUS, status))
        self._resume()
        if self._deadline is not None:
            self._deadline.cancel()
        if self._transport.can_write_eof():
            self._transport.write_eof()
        # on some systems, a close while bytes of the peer wait here would drop the status
        self._deadline = self._loop.call_later(LINGER_SECONDS, self._transport.abort)

    def abort(self) -> None:
        """Close the connection immediately."""
        if self._transport is not None:
            self._transport.abort()

    def look(self, now_s: float) -> None:
        """Give a sign of life if nothing else was written since the last look. End a stream that makes no progress."""
        if not self.is_opened or self.is_over or self._is_closing:  # a stream has no transport before its handshake
            return
        if self._frame_since_s is not None and now_s - self._frame_since_s > FRAME_SECONDS_MAX:
            self._owner.failed(self, unfinished(FRAME_SECONDS_MAX, self._frames.unfinished_bytes))
            return
        waiting_bytes = self._transport.get_write_buffer_size()
        if not waiting_bytes or waiting_bytes != self._stalled_bytes:
            self._stalled_since_s, self._stalled_bytes = now_s, waiting_bytes
        elif now_s - self._stalled_since_s > STALL_SECONDS_MAX:
            self.abort()
            return
        if not (self._has_written or waiting_bytes or unread_by_peer(self.socket)):
            self._write(ALIVE)
        self._has_written = False

    def _drop_frame(self) -> None:
        """Free the bytes of an unfinished frame, because the objects of a stream may stay in memory for a while."""
        self._leave_place(self._frames.unfinished_bytes)
        self._frames.drop()

    def _pause(self) -> None:
        """Stop reading, so that further bytes wait in the buffers of the system."""
        if not (self._is_paused or self.is_over or self._is_closing):
            self._is_paused, self._frame_since_s = True, None
            self._transport.pause_reading()
            self._hangups.watch(self.socket, self._transport.abort)

    def _resume(self) -> None:
        if self._is_paused and not self._is_closing:
            self._is_paused = False
            self._frame_since_s = self._loop.time() if self._frames.unfinished_bytes else None
            self._hangups.forget(self.socket)
            self._transport.resume_reading()

    @property
    def _is_closing(self) -> bool:
        """Whether the connection is closed, or will be soon. From then on uvloop's transport takes no calls."""
        return self._is_lost or self._transport.is_closing()

    def _answer(self, kind: int, body: bytes | memoryview) -> bool:
        """Let `take_in_same_turn` take a message if the method waits for one, and the peer takes the written bytes.

        So most requests with short work need no other turn of the loop, and no switch of tasks.
        """
        take, waiter = self.take_in_same_turn, self._waiter
        if take is None or kind != FrameKind.MESSAGE or waiter is None or waiter.done() or self._is_full:
            return False
        try:
            return take(body, self._write_message)
        except Exception as defect:  # noqa: BLE001  # the method ends with it, as if it had read the message
            waiter.set_exception(defect)
            self._waiter = waiter = None  # the error refers to this frame
            return True

    def _take(self, kind: int, body: bytes) -> None:
        if not self.is_opened:
            if kind != FrameKind.OPENING:
                raise InvalidArgument("a stream begins with a StreamOpening; see socket_stream.proto")
            assert self._deadline is not None, "a connection has a deadline until it is opened"
            self._deadline.cancel()
            self.is_opened = True
            self._owner.opened(self, opening_in(body))
            self._pause()  # until the method reads, so that the caller is admitted before it can send more
        elif kind == FrameKind.MESSAGE and not self._has_ended:
            self._messages.append(body)
            self._unread_bytes += len(body) + _MESSAGE_OVERHEAD_BYTES
            _wake(self._waiter)
        elif kind == FrameKind.END:
            self._has_ended = True
            _wake(self._waiter)
        else:
            raise InvalidArgument(f"a frame of kind {kind} came out of place; see socket_stream.proto")

    def _write_message(self, message: bytes | Sequence[bytes]) -> None:
        if isinstance(message, bytes) and len(message) <= _JOINED_BYTES_MAX:
            self._write(frame_of(FrameKind.MESSAGE, message))
            return
        parts = (message,) if isinstance(message, bytes) else message
        self._has_written = True
        self._transport.writelines((head_of(FrameKind.MESSAGE, sum(map(len, parts))), *parts))

    def _write(self, data: bytes) -> None:
        self._has_written = True
        self._transport.write(data)

    def _opening_overdue(self, opening_s: float) -> None:
        text = f"no whole StreamOpening came within {opening_s:g} s; send it when the socket opens"
        self._owner.failed(self, DeadlineExceeded(text))


def _wake(waiting: asyncio.Future[None] | None) -> None:
    if waiting is not None and not waiting.done():
        waiting.set_result(None)
