"""The frames of a stream over a socket (`proto/stampede_rt/v1/socket_stream.proto`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from struct import Struct

from stampede_rt.errors import InvalidArgument

PROTOCOL_VERSION = 1
OPENING_BYTES_MAX = 16 * 2**10
STATUS_BYTES_MAX = 64 * 2**10
_HEAD = Struct("<IB")
HEAD_BYTES = _HEAD.size


class FrameKind(IntEnum):
    """The kinds of frames."""

    MESSAGE = 0
    OPENING = 1
    STATUS = 2
    END = 3
    ALIVE = 4


Frame = tuple[int, bytes]
"""The kind and the body of a frame."""
FrameInBuffer = tuple[int, bytes | memoryview]
"""The kind and the body of a frame. The body of a long frame may be a view of its buffer."""


def head_of(kind: FrameKind, body_bytes: int) -> bytes:
    """Return the head of a frame with a body of that length."""
    return _HEAD.pack(body_bytes, kind)


def frame_of(kind: FrameKind, body: bytes = b"") -> bytes:
    """Return a whole frame. It copies the body."""
    return _HEAD.pack(len(body), kind) + body


def has_views(buffer: bytearray) -> bool:
    """Whether somebody has a view of the buffer. Python refuses to change the length of memory with views."""
    try:
        buffer.append(buffer.pop())
    except BufferError:
        return True
    return False


class FrameReader:
    """Cuts the bytes of a socket into frames. It keeps only the bytes of an unfinished frame, and one buffer.

    This buffer is the memory into which a socket writes the body of a long frame.
    """

    __slots__ = (
        "_bytes_max",
        "_kept_buffer",
        "_kept_bytes_max",
        "_new_buffer",
        "_partial",
        "_received_bytes",
        "_wanted_bytes",
    )

    def __init__(
        self,
        bytes_max: Mapping[FrameKind, int],
        kept_bytes_max: int = 0,
        new_buffer: Callable[[int], bytearray] = bytearray,
    ) -> None:
        """`bytes_max`: the longest body of each kind of frame that may come.

        `kept_bytes_max`: the reader keeps one buffer, and writes each frame of up to this length into it, unless
        somebody still has a view of the buffer. New memory for each frame would cost a page fault for each 4 KiB.
        `new_buffer` gives the buffer for a frame of a stated length; the buffer may be longer.
        """
        self._new_buffer = new_buffer
        self._kept_bytes_max = kept_bytes_max
        self._kept_buffer = bytearray()
        self._bytes_max: dict[int, int] = {int(kind): most for kind, most in bytes_max.items()}
        self._partial = bytearray()
        self._wanted_bytes = 0  # the length of the unfinished frame, or of its head
        self._received_bytes = 0  # the bytes in the buffer of an unfinished frame; 0: the frame has no buffer yet

    @property
    def unfinished_bytes(self) -> int:
        """The number of bytes that have come of an unfinished frame."""
        return self._received_bytes or len(self._partial)

    @property
    def wanted_bytes(self) -> int:
        """The length of the unfinished frame, or of its head while that is unfinished."""
        return self._wanted_bytes

    @property
    def missing_bytes(self) -> int:
        """The number of bytes that are missing of an unfinished frame, or of its head; 0 if no frame has begun."""
        return self._wanted_bytes - self.unfinished_bytes if self._partial else 0

    def place(self, short: memoryview) -> memoryview:
        """Return where to write the next bytes: `short`, or the buffer of an unfinished frame.

        Then call `take`.
        """
        return self.buffer() if self._received_bytes or self.missing_bytes > len(short) else short

    def take(self, short: memoryview, received_bytes: int) -> Sequence[FrameInBuffer]:
        """Take the bytes that were written to `place`. Returns the frames that are complete now.

        The body of a long frame is a view of its buffer. Raises InvalidArgument, as `feed`.
        """
        if not self._received_bytes:
            return self.feed(short[:received_bytes])
        found = self.filled_buffer(received_bytes)
        return [] if found is None else [found]

    def buffer(self) -> memoryview:
        """The part of a buffer for the missing bytes of the unfinished frame.

        Write the bytes there, and tell `filled` how many. `feed` must not be called until the frame is complete.
        """
        if not self._received_bytes:
            received, self._partial = self._partial, self._buffer_for(self._wanted_bytes)
            self._received_bytes = len(received)
            self._partial[: len(received)] = received
        return memoryview(self._partial)[self._received_bytes : self._wanted_bytes]

    def _buffer_for(self, frame_bytes: int) -> bytearray:
        if len(self._kept_buffer) >= frame_bytes and not has_views(self._kept_buffer):
            return self._kept_buffer
        buffer = self._new_buffer(frame_bytes)
        if frame_bytes <= self._kept_bytes_max:
            self._kept_buffer = buffer
        return buffer

    def filled(self, more_bytes: int) -> list[Frame]:
        """Take bytes that were written to `buffer`. Returns the frame if it is complete now."""
        self._received_bytes += more_bytes
        return [self._whole()] if self._received_bytes == self._wanted_bytes else []

    def filled_buffer(self, more_bytes: int) -> tuple[int, memoryview] | None:
        """Like `filled`, but the frame's body is a view of the buffer, not a copy. None: the frame is unfinished.

        The buffer belongs to the caller from now on.
        """
        self._received_bytes += more_bytes
        if self._received_bytes < self._wanted_bytes:
            return None
        buffer, end = self._partial, self._wanted_bytes
        self.drop()
        return buffer[4], memoryview(buffer)[HEAD_BYTES:end]

    def drop(self) -> None:
        """Free the bytes of an unfinished frame, if no more bytes will come."""
        self._partial, self._received_bytes = bytearray(), 0

    def feed(self, data: bytes | memoryview) -> list[Frame]:
        """Take the next bytes, and return the frames that are complete now. Copies the bytes that it keeps.

        Raises InvalidArgument for a frame of a kind that may not come, and for a body that is too long for its kind.
        """
        frames: list[Frame] = []
        at = self._complete(data, frames) if self._partial else 0
        if self._partial:
            return frames
        while len(data) - at >= HEAD_BYTES:
            end = at + HEAD_BYTES + self._body_bytes(data, at)
            if end > len(data):
                self._wanted_bytes = end - at
                break
            frames.append((data[at + 4], bytes(data[at + HEAD_BYTES : end])))
            at = end
        else:
            self._wanted_bytes = HEAD_BYTES
        if at < len(data):
            self._partial += memoryview(data)[at:]
        return frames

    def _complete(self, data: bytes | memoryview, frames: list[Frame]) -> int:
        """Add bytes to the unfinished frame. Returns the number of the bytes that were taken."""
        partial, at = self._partial, 0
        while True:  # twice, if the head was unfinished, too
            more = self._wanted_bytes - len(partial)
            partial += memoryview(data)[at : at + more]
            at = min(at + more, len(data))
            if len(partial) < self._wanted_bytes:
                return at
            whole_bytes = HEAD_BYTES + self._body_bytes(partial, 0)
            if whole_bytes == self._wanted_bytes:
                break
            self._wanted_bytes = whole_bytes
        frames.append(self._whole())
        return at

    def _whole(self) -> Frame:
        """The frame whose last byte has come."""
        partial = self._partial
        self.drop()
        return partial[4], bytes(memoryview(partial)[HEAD_BYTES : self._wanted_bytes])

    def _body_bytes(self, data: bytes | bytearray | memoryview, at: int) -> int:
        length, kind = _HEAD.unpack_from(data, at)
        allowed = self._bytes_max.get(kind, -1)
        if length > allowed:
            why = f"has {length} bytes; at most {allowed} are allowed" if allowed >= 0 else "may not come here"
            raise InvalidArgument(f"a frame of kind {kind} {why}; see socket_stream.proto")
        return int(length)
