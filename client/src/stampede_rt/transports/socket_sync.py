"""A stream over a socket of its own, in the blocking client. The calling thread itself sends and receives."""

from __future__ import annotations

import select
import socket
import threading
import weakref
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from math import inf
from queue import SimpleQueue
from time import monotonic
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.transports import forking
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.socket_errors import SocketError, broken, cancelled, error_of, silent
from stampede_rt.transports.socket_limits import (
    JOINED_BYTES_MAX,
    KEPT_BUFFER_BYTES_MAX,
    RECEIVE_BYTES,
    RECEIVED_BYTES_MAX,
    SILENCE_S_MAX,
)
from stampede_rt.transports.tls_layer import TlsLayer
from stampede_rt.wire.request_pieces import SOCKET_MESSAGE_BYTES_MAX, messages_of
from stampede_rt.wire.stream_frames import FrameInBuffer, FrameKind, FrameReader, frame_of, head_of

NO_SIGNAL = getattr(socket, "MSG_NOSIGNAL", 0)  # a send after the end of the connection must not end the process
Buffers = Sequence[bytes | memoryview]
_NO_WAIT = getattr(socket, "MSG_DONTWAIT", 0) | NO_SIGNAL
PARTS_MAX = 512  # the most parts of a request that this module sends unjoined; the system takes 1024 in one call
SHORT_BYTES_MAX = 4096  # to join two parts of this length takes less time than to send them as two
PART_BYTES_MIN = 1024  # the least average length of unjoined parts; to join shorter ones takes less time


class SocketCall:
    """A stream with the methods of `GrpcCall`."""

    def __init__(
        self,
        connected: socket.socket,
        method: BidiMethod,
        opening: bytes,
        *,
        in_turn: bool,
        tls: TlsLayer | None = None,
    ) -> None:
        """Send the encoded opening over the new connection. `tls`: the TLS of the connection, after its handshake.

        `in_turn`: one thread uses the stream, and reads the answer to each request before it sends the next one. Then
        `send` may block. Otherwise any thread may send while another one reads, and `send` does not block.
        """
        self._method = method
        self._in_turn = in_turn
        self._socket, self._tls = connected, tls
        self._forks = forking.forks()
        self._frames = FrameReader(RECEIVED_BYTES_MAX, KEPT_BUFFER_BYTES_MAX)
        self._received: deque[FrameInBuffer] = deque()
        self._is_cancelled = False
        self._failure: SocketError | None = None  # the error of a send
        self._mutex = threading.Lock()  # guards the sending side
        self._backlog = _Backlog(connected)
        # a new buffer for each read would take longer than the read
        self._buffer = memoryview(bytearray(RECEIVE_BYTES))
        self._encrypted = self._buffer if tls is None else memoryview(bytearray(RECEIVE_BYTES))
        self._limit = ReadLimit()
        connected.setblocking(True)
        self._readable = select.poll()  # unlike SO_RCVTIMEO, poll keeps its time limit even if many signals come
        self._readable.register(connected, select.POLLIN)
        forking.keep_out_of_children(connected)
        weakref.finalize(self, _drop, connected, self._backlog, self._forks)  # also at the end of the program
        self._write((head_of(FrameKind.OPENING, len(opening)), opening))

    @property
    def waiting_requests(self) -> int:
        """The number of writes that wait because the host takes no bytes."""
        return self._backlog.writes

    def send(self, request: Any) -> None:
        """Send `request`. If the stream has ended, `__next__` raises the reason.

        A list has the bytes of an encoded request in parts, which must not change any more.
        """
        encode = self._method.encode
        encoded: bytes | list[bytes] = request if encode is None else encode(request)
        try:
            with self._mutex:
                for buffers in _buffers_of(encoded):
                    self._write(buffers)
        except BaseException:  # an interrupt: the host may have half of a frame
            self.cancel()
            raise

    def __iter__(self) -> SocketCall:
        return self

    def limit(self, timeout_s: float | None) -> ReadLimit:
        """Return a context in which the reading thread waits for at most `timeout_s`; None: without limit.

        At the limit the reading thread cancels the stream, and adds an entry to the list that the context returns, as
        `Watchdog.limit` does. This limit needs no other thread.
        """
        self._limit.ends_s = inf if timeout_s is None else monotonic() + timeout_s
        return self._limit

    def __next__(self) -> Any:
        """Return the next response. Raises grpc.RpcError, or StopIteration at the end."""
        while True:
            while not self._received:
                if self._failure is not None:
                    raise self._failure.without_frames()
                self._receive()
            kind, body = self._received.popleft()
            if kind == FrameKind.MESSAGE:
                decode = self._method.decode
                return bytes(body) if decode is None else decode(body)
            if kind == FrameKind.STATUS:
                self._received.append((kind, body))  # for the next call
                self.cancel()
                raise error_of(body) or StopIteration

    def cancel(self) -> None:
        """End the stream. Any thread may do this."""
        self._is_cancelled = True
        _shut(self._socket, self._backlog, self._forks)

    def _receive(self) -> None:
        """Wait for the next bytes. Raises grpc.RpcError."""
        if not self._readable.poll(self._left_s() * 1000):
            self._left_s()  # raises if the limit is over
            raise silent(SILENCE_S_MAX)
        try:
            place = self._frames.place(self._buffer) if self._tls is None else self._encrypted
            received_bytes = self._socket.recv_into(place, 0, _NO_WAIT)
            if not received_bytes:
                raise cancelled() if self._is_cancelled else broken("the host has closed it")
            self._take(received_bytes)
        except BlockingIOError:
            return
        except OSError as error:
            raise (cancelled() if self._is_cancelled else broken(error.strerror or str(error))) from error
        except InvalidArgument as error:
            self.cancel()
            raise broken(str(error)) from error

    def _take(self, received_bytes: int) -> None:
        if self._tls is None:
            self._received.extend(self._frames.take(self._buffer, received_bytes))
            return
        self._tls.feed(self._encrypted[:received_bytes])
        while opened_bytes := self._tls.read(self._frames.place(self._buffer)):
            self._received.extend(self._frames.take(self._buffer, opened_bytes))

    def _left_s(self) -> float:
        """Return how long the thread may wait for bytes. Cancels the stream and raises if its limit is over."""
        left_s = self._limit.ends_s - monotonic()
        if left_s <= 0:
            self._limit.overdue.append(True)
            self.cancel()
            raise cancelled()
        return min(left_s, SILENCE_S_MAX)

    def _write(self, buffers: Buffers) -> None:
        """Send as much as the system takes now, and the rest later: on this thread if the stream is used `in_turn`.

        Otherwise the thread of the backlog sends the rest. The caller holds the mutex.
        """
        if self._failure is not None:  # each further piece would wait for the host again
            return
        try:
            left: Buffers = buffers if self._tls is None else (self._tls.encrypt(buffers),)
            if not self._backlog.writes:
                left = _send_some(self._socket, left)
            if left and self._in_turn:
                self._send_rest(left)
            elif left:
                self._backlog.send(left)
        except OSError:
            pass  # a read gives the reason: perhaps a status that came before the host closed the socket
        except SocketError as error:
            self._failure = error.without_frames()

    def _send_rest(self, left: Buffers) -> None:
        """Send the rest, and receive meanwhile. Waits as long as the host sends signs of life."""
        poll = select.poll()
        poll.register(self._socket, select.POLLIN | select.POLLOUT)
        while left and not any(kind == FrameKind.STATUS for kind, _ in self._received):
            events = poll.poll(self._left_s() * 1000)
            if not events:
                self._left_s()  # raises if the limit is over
                raise silent(SILENCE_S_MAX)
            if events[0][1] & ~select.POLLOUT:
                self._receive()
            left = _send_some(self._socket, left)


class ReadLimit:
    """The time at which the reading thread must stop waiting (monotonic clock)."""

    __slots__ = ("ends_s", "overdue")

    def __init__(self) -> None:
        self.ends_s = inf
        self.overdue: list[bool] = []
        """Gets an entry when the time is over. The stream is then cancelled."""

    def __enter__(self) -> list[bool]:
        return self.overdue

    def __exit__(self, *_error: object) -> None:
        self.ends_s = inf


class _Backlog:
    """Sends, on a thread of its own, bytes that the system did not take immediately.

    The first such bytes start the thread.
    """

    def __init__(self, connected: socket.socket) -> None:
        self.writes = 0
        """The number of writes that are not done."""
        self._socket = connected
        self._queue: SimpleQueue[Buffers | None] = SimpleQueue()
        self._mutex = threading.Lock()
        self._has_thread = False

    def send(self, left: Buffers) -> None:
        """Send `left` after everything before it. Does not wait."""
        with self._mutex:
            self.writes += 1
        self._queue.put(left)
        if not self._has_thread:
            self._has_thread = True
            threading.Thread(target=self._run, name="stampede sends", daemon=True).start()

    def _run(self) -> None:
        poll = select.poll()
        with suppress(OSError):
            poll.register(self._socket, select.POLLOUT)
            while (left := self._queue.get()) is not None:
                while left := _send_some(self._socket, left):
                    poll.poll()
                with self._mutex:
                    self.writes -= 1

    def close(self) -> None:
        """End the thread, once the socket is shut."""
        self._queue.put(None)


def _buffers_of(request: bytes | list[bytes]) -> Iterable[Buffers]:
    """Return the frames of a request, each in parts."""
    if isinstance(request, bytes) and len(request) <= SHORT_BYTES_MAX:
        return ((frame_of(FrameKind.MESSAGE, request),),)
    return _long_buffers_of(request)


def _long_buffers_of(request: bytes | list[bytes]) -> Iterator[Buffers]:
    """Yield the frames of a request, each in parts.

    Leaves long parts unjoined, because joining 900 KB takes as long as sending them.
    """
    size = sum(map(len, request)) if isinstance(request, list) and len(request) <= PARTS_MAX else 0
    if max(JOINED_BYTES_MAX, PART_BYTES_MIN * len(request)) < size <= SOCKET_MESSAGE_BYTES_MAX:
        yield head_of(FrameKind.MESSAGE, size), *request
        return
    for message in messages_of(request, SOCKET_MESSAGE_BYTES_MAX):
        yield head_of(FrameKind.MESSAGE, len(message)), message


def _send_some(connected: socket.socket, left: Buffers) -> Buffers:
    """Send the bytes that the system takes without waiting. Returns the rest."""
    while left:
        try:
            sent_bytes = connected.sendmsg(left, (), _NO_WAIT)
        except BlockingIOError:
            break
        left = () if sent_bytes == sum(map(len, left)) else _after(left, sent_bytes)
    return left


def _after(buffers: Buffers, sent_bytes: int) -> Buffers:
    """Return the parts of the buffers after the sent bytes. The buffers must hold more than the sent bytes."""
    at = 0
    while sent_bytes >= len(buffers[at]):
        sent_bytes -= len(buffers[at])
        at += 1
    return memoryview(buffers[at])[sent_bytes:], *buffers[at + 1 :]


def _shut(connected: socket.socket, backlog: _Backlog, forks: int) -> None:
    backlog.close()
    if forks == forking.forks():  # in a forked child the connection is the parent's
        with suppress(OSError):
            connected.shutdown(socket.SHUT_RDWR)


def _drop(connected: socket.socket, backlog: _Backlog, forks: int) -> None:
    _shut(connected, backlog, forks)
    connected.close()
