"""Finds the records of an MCAP file, which may be truncated, damaged or hostile.

This module reads the body of a record only when the caller needs it.

The `mcap` library decodes the records. It trusts the lengths in a file, so this module checks them first.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO, Any

from stampede_rt.errors import FileError
from stampede_rt.files.time_bounds import TimeBounds

try:
    import lz4.frame
    import zstandard
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.opcode import Opcode
    from mcap.records import Attachment, Chunk, McapRecord, Message
    from mcap.stream_reader import breakup_chunk
except ImportError as missing:
    raise FileError(
        "recordings need the library mcap, which is not installed; run: pip install 'stampede-rt[files]'"
    ) from missing

MAGIC = b"\x89MCAP0\r\n"
RECORD_BYTES_MAX = 256 * 1024 * 1024
"""The largest record that is read, and the largest chunk after decompression. A larger one counts as damage."""
CHUNK_RECORDS_MAX = 2**20
"""The most records of one chunk. A chunk with more counts as damage: a few kilobytes may decompress to millions of
records, and each record takes hundreds of bytes of memory.
"""
_FRAME = struct.Struct("<BQ")
_MESSAGE_HEAD_BYTES = 22
_CHUNK_HEAD = struct.Struct("<QQQII")
_KNOWN_OPCODES = range(0x01, 0x10)
_PRIVATE_OPCODES = range(0x80, 0x100)  # the opcodes of other programs; every reader skips them
# The part of a chunk's head that holds its compression, to find chunks after a damaged part.
_COMPRESSION = re.compile(rb"\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x00\x00\x00\x00")
_COMPRESSION_AT = _FRAME.size + 28
_SEARCH_BYTES = 4 * 1024 * 1024
DECODE_ERRORS = (
    McapError, ValueError, struct.error, KeyError, IndexError, OverflowError, MemoryError, RuntimeError, EOFError,
    zstandard.ZstdError,
)  # fmt: skip
"""The errors that a decoder raises for bytes that are no record."""


@dataclass(frozen=True, slots=True)
class RecordFrame:
    """A record's place: its first byte, its opcode, and the bytes of its body, which begins 9 bytes later."""

    offset: int
    opcode: int
    length: int

    @property
    def end(self) -> int:
        """The first byte after the record."""
        return self.offset + _FRAME.size + self.length


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a file that cannot be read, from the byte `offset` to `end`, exclusive, and why.

    `times`: the bounds of the times of its messages, inclusive; None: not known.
    """

    offset: int
    end: int
    detail: str
    times: TimeBounds = (None, None)


class RecordFile:
    """An open file of records. A context manager."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file. Raises FileError if it cannot be read or is no MCAP file."""
        self.path = os.fspath(path)
        try:
            self._file: IO[bytes] = open(path, "rb")  # noqa: SIM115  # this object closes it
        except OSError as error:
            raise FileError(f"the file {self.path!r} cannot be read: {error.strerror}") from error
        self.size = self._file.seek(0, os.SEEK_END)
        if self._read(0, len(MAGIC)) != MAGIC:
            self._file.close()
            if not self.size:
                raise FileError(f"the file {self.path!r} is empty: its writer ended before its first chunk")
            raise FileError(
                f"the file {self.path!r} is no MCAP file: it does not begin with the mark of MCAP; "
                "`stampede import` also reads rosbag2 and XDF"
            )

    def __enter__(self) -> RecordFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _read(self, offset: int, length: int) -> bytes:
        try:
            self._file.seek(offset)
            return self._file.read(length)
        except OSError as error:
            raise FileError(f"the file {self.path!r} cannot be read: {error.strerror or error}") from error

    def has_end_mark(self) -> bool:
        """Whether the file ends with the mark of MCAP."""
        return self._read(self.size - len(MAGIC), len(MAGIC)) == MAGIC

    def frames(self, offset: int = len(MAGIC)) -> Iterator[RecordFrame | Damage]:
        """Yield the records from the byte `offset` on, and the parts that are not records. Ends at the end mark.

        If the file has no end mark, the last part is a Damage, perhaps of no bytes.
        """
        while True:
            frame = self.frame_at(offset)
            if frame is not None and self.has_consistent_lengths(frame):
                yield frame
                offset = frame.end
                continue
            if self.size - offset == len(MAGIC) and self.has_end_mark():
                return
            next_chunk = self._next_chunk(offset + 1)
            if next_chunk is None:
                yield Damage(offset, self.size, "the file ends without its end mark")
                return
            yield Damage(offset, next_chunk, "these bytes are no record")
            offset = next_chunk

    def chunk_head(self, frame: RecordFrame) -> tuple[int, int, int] | None:
        """Return the first time, the last time and the decompressed size in the head of a chunk; None: it is no chunk.

        No checksum covers the head, so the values may be wrong.
        """
        head = self._read(frame.offset + _FRAME.size, _CHUNK_HEAD.size)
        return _CHUNK_HEAD.unpack(head)[:3] if frame.opcode == Opcode.CHUNK and len(head) == _CHUNK_HEAD.size else None

    def frame_at(self, offset: int) -> RecordFrame | None:
        """Return the record at a byte; None if there is no whole record."""
        head = self._read(offset, _FRAME.size)
        if len(head) < _FRAME.size:
            return None
        opcode, length = _FRAME.unpack(head)
        known = opcode in _KNOWN_OPCODES or opcode in _PRIVATE_OPCODES
        if not known or length > self.size - offset - _FRAME.size:
            return None
        return RecordFrame(offset, opcode, length)

    def _next_chunk(self, offset: int) -> int | None:
        """Find the next whole and undamaged chunk at or after a byte. Reads the file in parts."""
        while offset < self.size:
            part = self._read(offset, _SEARCH_BYTES + _COMPRESSION_AT + 8)
            for match in _COMPRESSION.finditer(part, _COMPRESSION_AT):
                start = match.start() - _COMPRESSION_AT
                if part[start] == Opcode.CHUNK and self.is_chunk(offset + start):
                    return offset + start
            offset += _SEARCH_BYTES
        return None

    def has_consistent_lengths(self, frame: RecordFrame) -> bool:
        """Whether the kind and the length of a record agree with the lengths inside it.

        No checksum covers the kind and the lengths. A flipped bit in them may hide a chunk: the chunk looks like
        another record, or lies inside a record that is too long.
        """
        if frame.opcode == Opcode.MESSAGE_INDEX:
            return frame.length == 6 + int.from_bytes(self._read(frame.offset + _FRAME.size + 2, 4), "little")
        return (frame.opcode == Opcode.CHUNK) is self._has_lengths_of_chunk(frame)

    def _has_lengths_of_chunk(self, frame: RecordFrame) -> bool:
        if frame.length < _CHUNK_HEAD.size + 8:
            return False
        name_length: int = _CHUNK_HEAD.unpack(self._read(frame.offset + _FRAME.size, _CHUNK_HEAD.size))[-1]
        stored = self._read(frame.offset + _FRAME.size + _CHUNK_HEAD.size + name_length, 8)
        return int.from_bytes(stored, "little") + _CHUNK_HEAD.size + name_length + 8 == frame.length

    def is_chunk(self, offset: int) -> bool:
        """Whether a whole and undamaged chunk begins at a byte. Reads it."""
        frame = self.frame_at(offset)
        if frame is None or frame.opcode != Opcode.CHUNK or not self._has_lengths_of_chunk(frame):
            return False
        try:
            self.chunk_records(frame)
        except FileError:
            return False
        return True

    def body(self, frame: RecordFrame) -> bytes:
        """Read the body of a record. Raises FileError if it is too large."""
        if frame.length > RECORD_BYTES_MAX:
            raise FileError(
                f"the record at byte {frame.offset} of {self.path!r} has {frame.length} bytes; at most "
                f"{RECORD_BYTES_MAX} are read; the file is damaged, or not made for this reader"
            )
        return self._read(frame.offset + _FRAME.size, frame.length)

    def checksum(self, offset: int, end: int, crc: int = 0) -> int:
        """Return the CRC-32 of the bytes from `offset` to `end`, exclusive. Reads them in parts.

        `crc`: the CRC-32 of the earlier bytes, if the checksum begins before `offset`.
        """
        while offset < end and (part := self._read(offset, min(_SEARCH_BYTES, end - offset))):
            crc = zlib.crc32(part, crc)
            offset += len(part)
        return crc

    def attachment(self, frame: RecordFrame) -> Attachment:
        """Decode an attachment. Raises FileError, also if it does not have the checksum that it states (0: none)."""
        found: Attachment = self.record(frame, Attachment)
        stated, end = int.from_bytes(self._read(frame.end - 4, 4), "little"), frame.end - 4
        if stated not in (0, self.checksum(frame.offset + _FRAME.size, end)):
            error = ValueError("its checksum does not match its content")
            raise self._damaged(frame, error) from error
        return found

    def record(self, frame: RecordFrame, kind: Any) -> Any:
        """Decode a record as a class of `mcap.records`. Raises FileError."""
        try:
            return kind.read(ReadDataStream(BytesIO(self.body(frame))))
        except DECODE_ERRORS as error:
            raise self._damaged(frame, error) from error

    def message(self, frame: RecordFrame) -> Message:
        """Decode a message that is in no chunk. Raises FileError."""
        body, number = self.body(frame), int.from_bytes
        if len(body) < _MESSAGE_HEAD_BYTES:
            raise FileError(f"the message at byte {frame.offset} of {self.path!r} is too short")
        return Message(
            channel_id=number(body[:2], "little"),
            sequence=number(body[2:6], "little"),
            log_time=number(body[6:14], "little"),
            publish_time=number(body[14:_MESSAGE_HEAD_BYTES], "little"),
            data=body[_MESSAGE_HEAD_BYTES:],
        )

    def chunk_records(self, frame: RecordFrame) -> list[McapRecord]:
        """Decode a chunk into its records. Raises FileError if its checksum, its compression or a record is wrong."""
        chunk: Chunk = self.record(frame, Chunk)
        try:
            data = _decompressed(chunk)
            if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
                raise ValueError("its checksum does not match its content")
            _check_count(data)
            plain = Chunk("", data, chunk.message_end_time, chunk.message_start_time, 0, len(data))
            return breakup_chunk(plain)
        except (*DECODE_ERRORS, TypeError) as error:
            raise self._damaged(frame, error) from error

    def _damaged(self, frame: RecordFrame, error: BaseException) -> FileError:
        return FileError(
            f"the record at byte {frame.offset} of {self.path!r} is damaged: {error or type(error).__name__}; "
            "`stampede file recover` saves the rest"
        )


def _check_count(data: bytes) -> None:
    """Raises ValueError if the content of a chunk has more than CHUNK_RECORDS_MAX records."""
    offset = found = 0
    while len(data) - offset >= _FRAME.size:
        if found == CHUNK_RECORDS_MAX:
            raise ValueError(f"it has more than {CHUNK_RECORDS_MAX} records, the most that are read")
        offset += _FRAME.size + _FRAME.unpack_from(data, offset)[1]
        found += 1


def _decompressed(chunk: Chunk) -> bytes:
    """Return the content of a chunk. Never makes more bytes than allowed, even if the chunk states a greater size."""
    limit = chunk.uncompressed_size
    if limit > RECORD_BYTES_MAX:
        raise ValueError(f"a chunk says that it has {limit} bytes; at most {RECORD_BYTES_MAX} are read")
    decompress = _DECOMPRESSORS.get(chunk.compression)
    if decompress is None:
        raise ValueError(f"its compression {chunk.compression!r} is not known")
    data = decompress(chunk.data, limit + 1)
    if len(data) != limit:
        raise ValueError(f"it has {len(data)} bytes in place of {limit}")
    return data


def _decompressed_zstd(data: bytes, bytes_max: int) -> bytes:
    with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as reader:
        return reader.read(bytes_max)


def _decompressed_lz4(data: bytes, bytes_max: int) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=bytes_max))


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda data, bytes_max: data[:bytes_max],
    "zstd": _decompressed_zstd,
    "lz4": _decompressed_lz4,
}
