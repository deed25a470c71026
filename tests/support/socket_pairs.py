"""The host's end of a stream over a pair of sockets. A test sends and receives its frames one by one."""

from __future__ import annotations

import socket

from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.wire.request_pieces import SOCKET_MESSAGE_BYTES_MAX
from stampede_rt.wire.stream_frames import Frame, FrameKind, FrameReader, frame_of

RAW = BidiMethod("/test/Raw", None, None, lambda: None)
OPENING = b"the opening"
_LIMITS = {FrameKind.MESSAGE: SOCKET_MESSAGE_BYTES_MAX, FrameKind.OPENING: 2**10}


class FarEnd:
    """The host's end of a stream."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        connected.settimeout(20)
        self._reader = FrameReader(_LIMITS)
        self._frames: list[Frame] = []

    def send(self, kind: FrameKind, body: bytes = b"") -> None:
        """Send a frame."""
        self.socket.sendall(frame_of(kind, body))

    def frame(self) -> Frame | None:
        """Return the next frame; None at the end of the connection."""
        while not self._frames:
            data = self.socket.recv(2**16)
            if not data:
                return None
            self._frames += self._reader.feed(data)
        return self._frames.pop(0)

    def message(self) -> bytes:
        """Return the next message."""
        frame = self.frame()
        assert frame is not None, "the connection has ended"
        assert frame[0] == FrameKind.MESSAGE
        return frame[1]
