"""A caller that writes HTTP/2 frames itself (RFC 9113), so that it can stop anywhere and ignore the server."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping

from stampede_rt.wire.varints import encode_varint

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
DATA, HEADERS, RST_STREAM, SETTINGS, PING, GOAWAY, WINDOW_UPDATE = 0, 1, 3, 4, 6, 7, 8
ACK, END_HEADERS = 1, 4
INITIAL_WINDOW_BYTES = 65_535


class RawConnection:
    """One connection to a gRPC server at `address`; it counts how many bytes of each stream the server has allowed."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.allowed_bytes: dict[int, int] = {}
        self.sent_bytes: dict[int, int] = {}  # by stream: the bytes that the methods `send_..._as_allowed` have sent
        self.ended: dict[int, asyncio.Event] = {}
        self.greeted = asyncio.Event()  # the server has sent its settings
        self.streams_max = 0
        self._initial_bytes = INITIAL_WINDOW_BYTES
        # The bytes that the caller may still send, on all streams together.
        self._connection_bytes = INITIAL_WINDOW_BYTES
        self._more_allowed = asyncio.Event()
        self._reader, self._writer = reader, writer
        self._next_stream = 1
        self._reading = asyncio.create_task(self._read_all())

    @classmethod
    async def open(cls, address: str) -> RawConnection:
        host, _, port = address.rpartition(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(PREFACE + _frame(SETTINGS, 0, 0, b""))
        return cls(reader, writer)

    async def call(self, method: str, metadata: Mapping[str, str] | None = None) -> int:
        """Begin a call, sending only its headers. Returns the number of the stream."""
        stream, self._next_stream = self._next_stream, self._next_stream + 2
        self.allowed_bytes[stream] = self._initial_bytes
        self.sent_bytes[stream] = 0
        self.ended[stream] = asyncio.Event()
        fields = {
            ":method": "POST",
            ":scheme": "http",
            ":path": method,
            ":authority": "test",
            "te": "trailers",
            "content-type": "application/grpc",
            **(metadata or {}),
        }
        self._writer.write(_frame(HEADERS, END_HEADERS, stream, b"".join(map(_literal, fields, fields.values()))))
        await self._writer.drain()
        return stream

    async def begin_message(self, stream: int, message_bytes: int, sent_bytes: int) -> None:
        """Announce a message and send only a part of it."""
        body = struct.pack("!BI", 0, message_bytes) + bytes(sent_bytes)
        for begin in range(0, len(body), 16_384):
            self._writer.write(_frame(DATA, 0, stream, body[begin : begin + 16_384]))
        await self._writer.drain()

    async def send_as_allowed(self, stream: int, message_bytes: int, sent_bytes: int) -> None:
        """Do as `begin_message` does, but never send more than the server allows.

        Returns early if the server ends the stream.
        """
        await self._send(stream, struct.pack("!BI", 0, message_bytes) + bytes(sent_bytes))

    async def send_message_as_allowed(self, stream: int, message: bytes) -> None:
        """Send a whole message, but never more than the server allows.

        Returns early if the server ends the stream.
        """
        await self._send(stream, struct.pack("!BI", 0, len(message)) + message)

    async def _send(self, stream: int, bytes_to_send: bytes) -> None:
        body, end = memoryview(bytes_to_send), self.sent_bytes[stream] + len(bytes_to_send)
        while (sent := self.sent_bytes[stream]) < end and not self.ended[stream].is_set():
            self._more_allowed.clear()
            room = min(16_384, self.allowed_bytes[stream] - sent, self._connection_bytes)
            if room <= 0:
                await self._more_allowed.wait()
                continue
            piece = body[len(body) - (end - sent) :][:room]
            self.sent_bytes[stream], self._connection_bytes = sent + len(piece), self._connection_bytes - len(piece)
            self._writer.write(_frame(DATA, 0, stream, piece))
            await self._writer.drain()

    async def reset(self, stream: int) -> None:
        """Cancel the call (RST_STREAM, CANCEL)."""
        self._writer.write(_frame(RST_STREAM, 0, stream, (8).to_bytes(4, "big")))
        self.ended[stream].set()
        await self._writer.drain()

    async def aclose(self) -> None:
        self._reading.cancel()
        self._writer.close()
        await asyncio.gather(self._reading, self._writer.wait_closed(), return_exceptions=True)

    async def _read_all(self) -> None:
        while True:
            head = await self._reader.readexactly(9)
            length, kind, flags, stream = int.from_bytes(head[:3], "big"), head[3], head[4], int.from_bytes(head[5:])
            body = await self._reader.readexactly(length)
            if kind == SETTINGS and not flags & ACK:
                self._adopt(body)
                self.greeted.set()
                self._writer.write(_frame(SETTINGS, ACK, 0, b""))
            elif kind == PING and not flags & ACK:
                self._writer.write(_frame(PING, ACK, 0, body))
            elif kind == WINDOW_UPDATE and not stream:
                self._connection_bytes += int.from_bytes(body, "big")
            elif kind == WINDOW_UPDATE:
                self.allowed_bytes[stream] += int.from_bytes(body, "big")
            elif stream and (kind == RST_STREAM or (kind == HEADERS and flags & 1)):
                self.ended[stream].set()
            self._more_allowed.set()

    def _adopt(self, settings: bytes) -> None:
        for begin in range(0, len(settings), 6):
            name, value = struct.unpack("!HI", settings[begin : begin + 6])
            if name == 3:  # SETTINGS_MAX_CONCURRENT_STREAMS
                self.streams_max = value
            elif name == 4:  # SETTINGS_INITIAL_WINDOW_SIZE, also for streams that are open
                grown, self._initial_bytes = value - self._initial_bytes, value
                self.allowed_bytes = {stream: allowed + grown for stream, allowed in self.allowed_bytes.items()}


def _frame(kind: int, flags: int, stream: int, body: bytes | memoryview) -> bytes:
    return len(body).to_bytes(3, "big") + bytes((kind, flags)) + stream.to_bytes(4, "big") + bytes(body)


def _literal(name: str, value: str) -> bytes:
    """A header field that the other side does not index (RFC 7541, section 6.2.2)."""
    return b"\x00" + _string(name) + _string(value)


def _string(text: str) -> bytes:
    raw = text.encode()
    length = bytes((len(raw),)) if len(raw) < 127 else b"\x7f" + encode_varint(len(raw) - 127)
    return length + raw
