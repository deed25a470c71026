"""Writes recordings: MCAP with chunks, indexes and compression, and with the facts that MCAP has no field for."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Literal, get_args

from stampede_rt.errors import FileError, InvalidArgument
from stampede_rt.files.entries import FACTS_TOPIC, INCARNATION_KEY, ChunkFacts, FileAdvance, FileEntry, Schema, Topic
from stampede_rt.values.recording import RecordingGap
from stampede_rt.version import VERSION

try:
    from mcap.writer import CompressionType, Writer
except ImportError as missing:
    raise FileError(
        "recordings need the library mcap, which is not installed; run: pip install 'stampede-rt[files]'"
    ) from missing

Compression = Literal["zstd", "lz4", "none"]
COMPRESSIONS: tuple[Compression, ...] = get_args(Compression)
CHUNK_BYTES = 1024 * 1024  # before compression; a larger message has a chunk of its own
FACTS_BYTES_PER_ITEM = 16  # counts towards CHUNK_BYTES, so that a chunk of many empty items ends, too
PART_SUFFIX = ".part"  # the end of the name of a file that `replacing` has not finished
TOPICS_MAX = 65_000  # MCAP numbers them with 16 bits
_REMEDIES = {
    errno.ENOSPC: "free space",
    errno.EDQUOT: "free space",
    errno.EFBIG: "raise the limit of the length of a file (ulimit -f), or name a file on another file system",
    errno.EIO: "name a file on another disk",
}
_TYPES = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


def parse_compression(text: str) -> Compression:
    """Return the compression of that name. Raises InvalidArgument."""
    for known in COMPRESSIONS:
        if text == known:
            return known
    raise InvalidArgument(f"compression is {text!r}; write one of {', '.join(map(repr, COMPRESSIONS))}")


def opened_new(path: str | os.PathLike[str], *, overwrite: bool) -> IO[bytes]:
    """Open a new file for writing. Raises FileError if it exists and `overwrite` is False, or cannot be made."""
    try:
        return open(path, "wb" if overwrite else "xb")
    except FileExistsError as error:
        raise _exists(path) from error
    except OSError as error:
        raise write_fault(path, error) from error


def _exists(path: str | os.PathLike[str]) -> FileError:
    return FileError(
        f"the file {os.fspath(path)!r} exists; name another one, or overwrite it (--overwrite, overwrite=True)"
    )


def write_fault(path: str | os.PathLike[str], error: OSError) -> FileError:
    """Return the error for a file that cannot be written. A file whose name ends with PART_SUFFIX does not stay."""
    name, remedy = os.fspath(path), _REMEDIES.get(error.errno or 0)
    if name.endswith(PART_SUFFIX):
        name, stays = name.removesuffix(PART_SUFFIX), "no new file was written"
    else:
        stays = "`stampede file recover` reads the items of a recording so far"
    advice = f"{remedy}; {stays}" if remedy else "name a file in a folder that exists and that you may write to"
    return FileError(f"the file {name!r} cannot be written: {error.strerror}; {advice}")


@contextmanager
def replacing(path: str | os.PathLike[str], *, overwrite: bool) -> Iterator[FileWriter]:
    """Give a writer of a file that gets its name `path` when the block ends (see `replaced`). Raises FileError."""
    with replaced(path, overwrite=overwrite) as part:
        writer = FileWriter(part, overwrite=True)
        try:
            yield writer
        finally:
            writer.abandon()


@contextmanager
def replaced(path: str | os.PathLike[str], *, overwrite: bool) -> Iterator[Path]:
    """Give the path of a file to write, which gets its name `path` when the block ends.

    Until then its name ends with PART_SUFFIX. After an error there is no such file, and a former file `path` stays.
    Raises FileError, also if the file exists and `overwrite` is False.
    """
    target = os.path.realpath(path)
    if os.path.exists(target) and not (overwrite and os.path.isfile(target)):
        raise _exists(path)
    part = Path(target + PART_SUFFIX)
    try:
        yield part
        try:
            os.replace(part, target)
        except OSError as error:
            raise write_fault(path, error) from error
    finally:
        part.unlink(missing_ok=True)


class FileWriter:
    """Writes one file. Only one thread may use it at a time. After `finish` or an error it takes nothing more.

    Facts are the properties of items that MCAP has no field for, such as seqs and durations. Each chunk ends with its
    facts, so a file that is cut off at any byte still has the facts of every whole chunk.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        compression: str = "zstd",
        overwrite: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        kind = _TYPES[parse_compression(compression)]
        self.path = Path(path)
        self._chunk_bytes = chunk_bytes
        self._stream = opened_new(path, overwrite=overwrite)
        # This class ends the chunks. The indexes of messages have no checksum of their own. The checksum of the data
        # covers them.
        self._writer = Writer(self._stream, chunk_size=1 << 62, compression=kind, enable_data_crcs=True)
        self._topics: dict[Topic, int] = {}
        self._schemas: dict[Schema, int] = {}
        self._facts_id: int | None = None
        self._facts = ChunkFacts()
        self._pending_bytes = 0
        self._facts_time = 0
        self._closed = False
        self._attempt(lambda: self._writer.start("", f"stampede-rt {VERSION}"))

    @property
    def pending(self) -> bool:
        """Whether the writer has messages, gaps or advances that are not in the file yet."""
        return self._pending_bytes > 0

    def add(self, entries: Iterable[FileEntry]) -> None:
        """Write messages. Raises FileError."""
        self._attempt(lambda: self._add(entries))

    def add_gap(self, gap: RecordingGap) -> None:
        """Write that items are missing. Raises FileError."""
        self._facts.gaps.append(gap)
        self._noted()

    def add_advance(self, advance: FileAdvance) -> None:
        """Write an advance. Raises FileError."""
        self._facts.advances.append(advance)
        self._noted()

    def _noted(self) -> None:
        self._pending_bytes += 256
        if self._pending_bytes >= self._chunk_bytes:
            self.flush()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, after everything before it. Raises FileError."""
        self.flush()
        self._attempt(lambda: self._writer.add_metadata(name, dict(values)))

    def add_attachment(self, log_time: int, create_time: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment, after everything before it. Raises FileError."""
        self.flush()
        self._attempt(lambda: self._writer.add_attachment(create_time, log_time, name, media_type, data))

    def flush(self) -> None:
        """End the chunk, and give it to the operating system. Raises FileError."""
        if self._pending_bytes:
            self._attempt(self._end_chunk)

    def finish(self) -> None:
        """Write the indexes, and wait until the disk has the file. Raises FileError."""
        self.flush()

        def end() -> None:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()

        self._attempt(end)
        self._closed = True

    def abandon(self) -> None:
        """Close the file without its indexes. Does nothing after `finish`."""
        self._closed = True
        try:
            self._stream.close()
        except OSError:  # the disk is full: the bytes in the file stay
            return

    def _attempt(self, step: Callable[[], None]) -> None:
        if self._closed:
            raise FileError(f"the file {os.fspath(self.path)!r} is closed")
        try:
            step()
        except OSError as error:
            self.abandon()
            raise write_fault(self.path, error) from error

    def _add(self, entries: Iterable[FileEntry]) -> None:
        add_message, facts = self._writer.add_message, self._facts
        for entry in entries:
            number = self._topics.get(entry.topic)
            if number is None:
                number = self._register(entry.topic)
            if self._pending_bytes and self._pending_bytes + len(entry.data) > self._chunk_bytes:
                self._end_chunk()
                facts = self._facts
            add_message(number, entry.log_time, entry.data, entry.publish_time, entry.sequence)
            facts.add(entry)
            self._facts_time = entry.log_time
            self._pending_bytes += len(entry.data) + 31 + FACTS_BYTES_PER_ITEM + 16 * len(entry.attributes)

    def _end_chunk(self) -> None:
        encoded = self._facts.encoded()
        if encoded is not None:
            if self._facts_id is None:
                self._facts_id = self._writer.register_channel(FACTS_TOPIC, "json", 0, {"version": "1"})
            self._writer.add_message(self._facts_id, self._facts_time, encoded, self._facts_time)
        self._facts, self._pending_bytes = ChunkFacts(), 0
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _register(self, topic: Topic) -> int:
        if len(self._topics) >= TOPICS_MAX:
            raise FileError(f"the file {os.fspath(self.path)!r} has {TOPICS_MAX} topics; record fewer channels")
        schema_id = 0
        if topic.schema is not None:
            known = self._schemas.get(topic.schema)
            schema_id = known or self._writer.register_schema(
                topic.schema.name, topic.schema.encoding, topic.schema.data
            )
            self._schemas[topic.schema] = schema_id
        metadata = dict(topic.metadata)
        if topic.incarnation is not None:
            metadata[INCARNATION_KEY] = str(topic.incarnation)
        self._topics[topic] = self._writer.register_channel(topic.name, topic.encoding, schema_id, metadata)
        return self._topics[topic]
