"""The facts at the end of a whole file, and whether the contents of the file agree with them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, Footer, Metadata, MetadataIndex, Statistics
from mcap.records import Schema as SchemaRecord

from stampede_rt.files.chunk_content import ChunkContent
from stampede_rt.files.entries import FACTS_TOPIC, INCARNATION_KEY, Schema, Topic
from stampede_rt.files.framing import MAGIC, Damage, RecordFile, RecordFrame
from stampede_rt.values.recording import incarnation_of

_FOOTER_BYTES, _DATA_END_BYTES = 9 + 20 + len(MAGIC), 9 + 4


@dataclass(slots=True)
class FileIndex:
    """The facts at the end of a whole file: counts, chunks, topics and metadata, without reading the messages.

    `data_end`: the byte at which the data end, and the record DataEnd begins.
    """

    data_end: int
    statistics: Statistics | None = None
    chunks: list[ChunkIndex] = field(default_factory=list)
    topics: dict[int, Topic] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: list[MetadataIndex] = field(default_factory=list)
    places: dict[int, ChunkIndex] = field(default_factory=dict)  # the chunks by their first bytes


def says_no_index(records: RecordFile) -> bool:
    """Whether the end of a file says that the file has no index. Then the end of the data is just before the footer."""
    footer = _footer(records)
    before = None if footer is None else records.frame_at(footer.offset - _DATA_END_BYTES)
    if footer is None or before is None or before.opcode != Opcode.DATA_END or before.end != footer.offset:
        return False
    return int(records.record(footer, Footer).summary_start) == 0


def read_index(records: RecordFile) -> FileIndex | None:
    """Return the index of a file; None if the file has none, or if it is damaged. Raises FileError if it is damaged."""
    place = _footer(records)
    if place is None:
        return None
    footer = records.record(place, Footer)
    start = footer.summary_start
    if not len(MAGIC) <= start < place.offset:
        return None
    if footer.summary_crc and records.checksum(start, place.end - 4) != footer.summary_crc:
        return None
    index = FileIndex(start - _DATA_END_BYTES)
    for frame in records.frames(start):
        if isinstance(frame, Damage):
            return None
        if frame.offset >= place.offset:
            break
        _add(index, frame, records)
    return index


def _footer(records: RecordFile) -> RecordFrame | None:
    place = records.frame_at(records.size - _FOOTER_BYTES) if records.size > _FOOTER_BYTES else None
    return place if place is not None and place.opcode == Opcode.FOOTER and records.has_end_mark() else None


def _add(index: FileIndex, frame: RecordFrame, records: RecordFile) -> None:
    if frame.opcode == Opcode.SCHEMA:
        schema = records.record(frame, SchemaRecord)
        index.schemas[schema.id] = Schema(schema.name, schema.encoding, schema.data)
    elif frame.opcode == Opcode.CHANNEL:
        channel = records.record(frame, Channel)
        index.topics[channel.id] = topic_of(channel, index.schemas)
    elif frame.opcode == Opcode.STATISTICS:
        index.statistics = records.record(frame, Statistics)
    elif frame.opcode == Opcode.CHUNK_INDEX:
        chunk = records.record(frame, ChunkIndex)
        index.chunks.append(chunk)
        index.places[chunk.chunk_start_offset] = chunk
    elif frame.opcode == Opcode.METADATA_INDEX:
        index.metadata.append(records.record(frame, MetadataIndex))


def topic_of(channel: Channel, schemas: dict[int, Schema]) -> Topic:
    """Return the topic of a channel record."""
    metadata = dict(channel.metadata)
    text = metadata.pop(INCARNATION_KEY, "")
    try:
        incarnation = incarnation_of(text) if text else None
    except ValueError:  # the topic of another program
        incarnation = None
    schema = schemas.get(channel.schema_id) if channel.schema_id else None
    return Topic(channel.topic, channel.message_encoding, incarnation, schema, tuple(metadata.items()))


def is_indexed(content: ChunkContent, entry: ChunkIndex, records: RecordFile) -> bool:
    """Whether a chunk is the one that an entry of the index names. A faulty copy may have another chunk there.

    The entry has the facts in the head of the chunk, and the topics of its messages. Some writers leave the topics out.
    """
    frame = records.frame_at(content.offset)
    stated = (entry.message_start_time, entry.message_end_time, entry.uncompressed_size)
    if frame is None or frame.end != entry.chunk_start_offset + entry.chunk_length:
        return False
    named = entry.message_index_offsets.keys()
    return records.chunk_head(frame) == stated and (not named or named == content.messages.keys())


class ContentCounts:
    """Counts the contents of a file, to compare them with its index."""

    def __init__(self) -> None:
        self._messages: Counter[int] = Counter()
        self._attachments = self._metadata = 0
        self._misplaced = 0  # chunks that the index does not name at their places

    def add(self, part: ChunkContent | Attachment | Metadata) -> None:
        """Count a part of the file."""
        if isinstance(part, ChunkContent):
            self._messages.update(part.messages)
            self._misplaced += not part.is_indexed
        elif isinstance(part, Attachment):
            self._attachments += 1
        else:
            self._metadata += 1

    def differences(self, index: FileIndex | None, *, skip_own_channels: bool) -> list[str]:
        """Return where the file disagrees with its index, as texts.

        `skip_own_channels`: leave out the messages of channels of Stampede RT, because the caller compares their counts
        with the recorder's summary.
        """
        if index is None:
            return []
        stated, wrong = index.statistics, []
        if self._misplaced:
            wrong.append(f"{self._misplaced} chunks are not those that the index names at their places")
        if stated is None:
            return wrong
        for number in sorted(stated.channel_message_counts.keys() | self._messages.keys()):
            topic = index.topics.get(number)
            is_own = topic is not None and (topic.incarnation is not None or topic.name == FACTS_TOPIC)
            if topic is not None and not (skip_own_channels and is_own):
                stated_count = stated.channel_message_counts.get(number, 0)
                wrong += _difference(f"messages of topic {topic.name!r}", stated_count, self._messages[number])
        wrong += _difference("attachments", stated.attachment_count, self._attachments)
        return wrong + _difference("records of metadata", stated.metadata_count, self._metadata)


def _difference(what: str, stated: int, found: int) -> list[str]:
    return [f"the index says {stated} {what}, the file has {found}"] if stated != found else []
