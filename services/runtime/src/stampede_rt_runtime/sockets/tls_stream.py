"""The TLS of an accepted connection, between its transport and the stream. It bounds the work of handshakes.

A step of a handshake takes up to a millisecond, and any caller may begin a handshake. So the event loop takes
STEPS_PER_TURN of them, and then none for PAUSE_SECONDS. asyncio's own TLS would take all of them in one turn.
"""

from __future__ import annotations

import asyncio
import ssl
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from typing import Any

from stampede_rt.transports.tls_layer import TlsLayer
from stampede_rt_runtime.sockets.stream_socket import StreamSocket

STEPS_PER_TURN = 2
PAUSE_SECONDS = 0.003
"""A handshake has two steps. So a host serves about 300 handshakes a second, in a fourth of its time."""


class HandshakeSteps:
    """Takes the steps of all handshakes of a service, one of each machine in turn.

    So a machine with hundreds of handshakes delays a handshake of another machine by only one step.
    """

    def __init__(self) -> None:
        self._lines: OrderedDict[str, deque[Callable[[], object]]] = OrderedDict()
        self._is_due = False

    def add(self, machine: str, step: Callable[[], object]) -> None:
        """Call `step` soon, after the earlier steps of its machine."""
        self._lines.setdefault(machine, deque()).append(step)
        if not self._is_due:
            self._is_due = True
            asyncio.get_running_loop().call_soon(self._take_some)

    def _take_some(self) -> None:
        for _ in range(STEPS_PER_TURN):
            if not self._lines:
                break
            machine, line = self._lines.popitem(last=False)
            step = line.popleft()
            if line:
                self._lines[machine] = line  # after the others
            step()
        self._is_due = bool(self._lines)
        if self._is_due:
            asyncio.get_running_loop().call_later(PAUSE_SECONDS, self._take_some)


class TlsStream(asyncio.BufferedProtocol):
    """The protocol of the connection, and the transport of its stream, which begins after the handshake."""

    def __init__(
        self,
        stream: StreamSocket,
        tls: TlsLayer,
        steps: HandshakeSteps,
        short: memoryview,
        handshake_s: float,
    ) -> None:
        """`short`: memory for one read, which all connections share."""
        self._stream, self._tls, self._steps, self._short = stream, tls, steps, short
        self._handshake_s = handshake_s
        self._transport: Any = None
        self._deadline: asyncio.TimerHandle | None = None
        self._is_secured = self._is_paused = False

    # --- asyncio calls these methods

    def connection_made(self, transport: Any) -> None:
        """Wait for the caller's handshake, for a limited time."""
        self._transport = transport
        self._deadline = asyncio.get_running_loop().call_later(self._handshake_s, transport.abort)

    def get_buffer(self, _sizehint: int) -> memoryview:
        """The memory for the next encrypted bytes."""
        return self._short

    def buffer_updated(self, received_bytes: int) -> None:
        """Take encrypted bytes. During a handshake, reading stops until the next step is performed."""
        self._tls.feed(self._short[:received_bytes])
        if self._is_secured:
            self._open_some()
        else:
            self._transport.pause_reading()
            self._steps.add(self._stream.machine, self._continue_handshake)

    def eof_received(self) -> bool:
        """Note that the peer has gone."""
        return self._stream.eof_received() if self._is_secured else False

    def pause_writing(self) -> None:
        """Stop writing, because the socket's buffer is full."""
        self._stream.pause_writing()

    def resume_writing(self) -> None:
        """Write again, because the system has sent all bytes."""
        self._stream.resume_writing()

    def connection_lost(self, error: Exception | None) -> None:
        """Note that the peer has gone, or that the connection was closed here.

        The stream refers to this object. This object drops its reference to the stream, so that Python frees OpenSSL's
        30 KB now, and not at a later garbage collection.
        """
        if self._deadline is not None:
            self._deadline.cancel()
        self._is_paused = True
        self._stream.connection_lost(error)
        del self._stream, self._tls

    # --- the stream calls these methods of a transport

    def write(self, data: bytes) -> None:
        """Encrypt and send."""
        self.writelines((data,))

    def writelines(self, parts: Iterable[bytes]) -> None:
        """Encrypt and send the parts of a message."""
        try:
            self._transport.write(self._tls.encrypt(parts))
        except ssl.SSLError:  # the peer has ended its TLS
            self._transport.abort()

    def pause_reading(self) -> None:
        """Stop reading: the next bytes stay in the system."""
        self._is_paused = True
        self._transport.pause_reading()

    def resume_reading(self) -> None:
        """Read again."""
        self._is_paused = False
        self._transport.resume_reading()
        if self._tls.has_more:
            asyncio.get_running_loop().call_soon(self._open_some)

    def can_write_eof(self) -> bool:
        """Whether one side can close while the other stays open. TLS does not allow this."""
        return False

    def __getattr__(self, name: str) -> Any:
        """The other methods of the transport."""
        return getattr(self._transport, name)

    def _continue_handshake(self) -> None:
        if self._transport.is_closing():
            return
        try:
            self._is_secured = self._tls.continue_handshake()
            self._transport.write(self._tls.to_send())
        except ssl.SSLError:
            self._transport.write(self._tls.to_send())  # the alert gives the caller the reason
            self._transport.close()
            return
        self._transport.resume_reading()
        if self._is_secured and self._deadline is not None:
            self._deadline.cancel()
            self._stream.certificate = self._tls.peer_certificate()
            self._stream.connection_made(self)
            self._open_some()

    def _open_some(self) -> None:
        """Decrypt the bytes that have come, and pass them to the stream, until it pauses."""
        try:
            while not self._is_paused and (opened_bytes := self._tls.read(self._stream.get_buffer(-1))):
                self._stream.buffer_updated(opened_bytes)
        except ssl.SSLError:
            self._transport.abort()
