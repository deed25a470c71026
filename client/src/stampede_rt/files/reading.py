"""Reads files chunk by chunk: messages with their facts, gaps, advances, and damaged parts."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata
from mcap.records import Schema as SchemaRecord

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import ChunkContent, IncarnationKey
from stampede_rt.files.data_sum import DataSum
from stampede_rt.files.entries import FACTS_TOPIC, FileEntry, ReadFacts, Schema, Topic, content_type_of_encoding
from stampede_rt.files.file_index import FileIndex, is_indexed, read_index, says_no_index, topic_of
from stampede_rt.files.framing import MAGIC, Damage, RecordFile, RecordFrame
from stampede_rt.files.indexed_frames import has_records_beside, indexed_frames
from stampede_rt.files.named_by_facts import facts_topic, is_facts, topics_of
from stampede_rt.files.summaries import SUMMARY_NAME, summary_of
from stampede_rt.files.time_bounds import joined_times, known_times
from stampede_rt.values.recording import RecordingSummary

CLOCKS_NAME = "stampede.clocks"


class FileReader:
    """Reads one MCAP file. A context manager. Keeps one chunk in memory at a time."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file. Raises FileError if it cannot be read or is no MCAP file."""
        self._records = RecordFile(path)
        self.path = self._records.path
        self.size = self._records.size
        self._schemas: dict[int, Schema] = {}
        self._topics: dict[int, Topic] = {}
        self._places: dict[IncarnationKey, int] = {}  # for each incarnation the least number of its topics
        self._facts_ids: set[int] = set()
        self.library = ""
        self._index: FileIndex | None = None
        self._looked = False
        self.says_no_index = False  # whether the end of the file says that it has no index; known after `index`
        # Whether the bytes before the index have the stated checksum, if there is one; known after `contents`.
        self.data_is_whole = True
        self._has_chunks = False  # whether this reader has found a chunk so far
        first = self._records.frame_at(len(MAGIC))
        if first is not None and first.opcode == Opcode.HEADER:
            with suppress(FileError):  # a damaged head: the rest may be whole
                self.library = str(self._records.record(first, Header).library)

    def __enter__(self) -> FileReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._records.__exit__()

    @property
    def index(self) -> FileIndex | None:
        """The index at the end of the file; None if the file has none, as after a crash of its writer."""
        if not self._looked:
            self._looked = True
            try:
                self.says_no_index = says_no_index(self._records)
                self._index = read_index(self._records)
            except FileError:  # a damaged index counts as a missing one
                self._index = None
            for number, topic in self._index.topics.items() if self._index is not None else ():
                self._place(number, topic)
        return self._index

    def contents(self) -> Iterator[ChunkContent | Damage | Attachment | Metadata]:
        """Yield the chunks in the order of the file, damaged parts, attachments, and metadata."""
        data_sum, self.data_is_whole = self.data_sum(), self.index is None
        for frame in self._frames():
            data_sum.read_to(frame.offset)
            if isinstance(frame, Damage):
                yield self._with_times(frame)
            elif frame.opcode not in (Opcode.DATA_END, Opcode.FOOTER):
                if (found := self._read_or_damage(frame)) is not None:
                    yield found
            elif self.index is None:  # no index, or a damaged one: read on to the end of the file
                if frame.opcode == Opcode.DATA_END:
                    self.data_is_whole = data_sum.is_stated_at(frame.offset)
            elif frame.offset < self.index.data_end:
                yield Damage(frame.offset, self.index.data_end, "the data end before the place that the index names")
                return
            else:
                self.data_is_whole = data_sum.is_stated_at(frame.offset)
                return

    def data_sum(self) -> DataSum:
        """Begin a checksum of the file's data. It covers no bytes yet."""
        return DataSum(self._records)

    def _frames(self) -> Iterator[RecordFrame | Damage]:
        self._has_chunks = self.index is not None and bool(self.index.chunks)
        if self.index is None:
            return self._records.frames()
        ends = {one.chunk_start_offset: one.chunk_start_offset + one.chunk_length for one in self.index.chunks}
        return indexed_frames(self._records, ends)

    def _is_indexed(self, content: ChunkContent) -> bool:
        """Whether a chunk is the one that the index names at its place. True if the index names no chunks."""
        if self.index is None or not self.index.chunks:
            return True
        entry = self.index.places.get(content.offset)
        return entry is not None and is_indexed(content, entry, self._records)

    def _read_or_damage(self, frame: RecordFrame) -> ChunkContent | Damage | Attachment | Metadata | None:
        try:
            return self._read(frame)
        except FileError as error:
            head = self._records.chunk_head(frame)
            times = (None, None) if head is None else known_times(*head[:2])
            return self._with_times(Damage(frame.offset, frame.end, str(error.__cause__ or "") or error.message, times))

    def _with_times(self, damage: Damage) -> Damage:
        """Add the times that the index has for the damaged chunks."""
        inside = [
            known_times(one.message_start_time, one.message_end_time)
            for one in (self.index.chunks if self.index is not None else ())
            if one.chunk_start_offset < damage.end and damage.offset < one.chunk_start_offset + one.chunk_length
        ]
        return replace(damage, times=reduce(joined_times, inside)) if inside else damage

    def content_at(self, offset: int) -> ChunkContent:
        """Read the chunk at a byte, as the index names it. Raises FileError."""
        frame = self._records.frame_at(offset)
        if frame is None or frame.opcode != Opcode.CHUNK or not self._records.has_consistent_lengths(frame):
            raise FileError(f"the index of {self.path!r} names a chunk at byte {offset}, and there is none")
        content = self._content(frame, self._records.chunk_records(frame))
        self.check(content)
        return content

    def check(self, content: ChunkContent) -> None:
        """Check that the index names a chunk, and that the file names the topic of each message. Raises FileError."""
        if not content.is_indexed:
            raise FileError(
                f"the chunk at byte {content.offset} of {self.path!r} is not the one that the index names there, so "
                "the file may lack items; `stampede file recover` saves its items"
            )
        if content.unknown:
            raise FileError(
                f"{content.unknown} messages at byte {content.offset} of {self.path!r} are of topics that the file "
                "does not name; `stampede file recover` saves the other messages"
            )

    def indexes_all(self) -> bool:
        """Whether the index names all chunks, and no message is outside of chunks. False without an index."""
        if self.index is None:
            return False
        indexed = (
            (one.chunk_start_offset, one.chunk_start_offset + one.chunk_length + one.message_index_length)
            for one in self.index.chunks
        )
        return not has_records_beside(self._records, indexed, self.index.data_end)

    def metadata(self, name: str) -> dict[str, str] | None:
        """Return the last metadata record of that name that the index names; None if there is none."""
        places = [one for one in (self.index.metadata if self.index else ()) if one.name == name]
        if not places:
            return None
        if (frame := self._records.frame_at(places[-1].offset)) is None or frame.opcode != Opcode.METADATA:
            return None
        record = self._records.record(frame, Metadata)
        return dict(record.metadata) if record.name == name else None

    def summary(self) -> RecordingSummary | None:
        """Return the summary that a recorder wrote; None if there is none. Raises FileError if it is damaged."""
        found = self.metadata(SUMMARY_NAME)
        return None if found is None else summary_of(self.path, found)

    def summary_if_readable(self) -> RecordingSummary | None:
        """Return the summary; None if there is none, or if it is damaged.

        If the index names no summary, this reads the heads of all records to find it.
        """
        with suppress(FileError):
            if (found := self.summary()) is not None:
                return found
        frames = [one for one in self._frames() if isinstance(one, RecordFrame) and one.opcode == Opcode.METADATA]
        for frame in reversed(frames):
            with suppress(FileError):
                record = self._records.record(frame, Metadata)
                if record.name == SUMMARY_NAME:
                    return summary_of(self.path, record.metadata)
        return None

    def _read(self, frame: RecordFrame) -> ChunkContent | Attachment | Metadata | None:
        if frame.opcode == Opcode.CHUNK:
            self._has_chunks = True
            return self._content(frame, self._records.chunk_records(frame))
        if frame.opcode == Opcode.MESSAGE:
            content = self._content(frame, [self._records.message(frame)])
            if content.bare and self._has_chunks:
                raise FileError(f"the message at byte {frame.offset} of {self.path!r} is in no chunk")
            return content
        if frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = SchemaRecord if frame.opcode == Opcode.SCHEMA else Channel
            self._learn(self._records.record(frame, kind))
        if frame.opcode == Opcode.ATTACHMENT:
            return self._records.attachment(frame)
        if frame.opcode == Opcode.METADATA:
            return self._records.record(frame, Metadata)  # type: ignore[no-any-return]
        return None

    def _learn(self, record: McapRecord) -> None:
        if isinstance(record, SchemaRecord):
            self._schemas[record.id] = Schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            if record.topic == FACTS_TOPIC:
                self._facts_ids.add(record.id)
            self._topics[record.id] = topic = topic_of(record, self._schemas)
            self._place(record.id, topic)

    def _place(self, number: int, topic: Topic) -> None:
        key = (topic.name, topic.incarnation)
        self._places[key] = min(number, self._places.get(key, number))

    def _content(self, frame: RecordFrame, records: Sequence[McapRecord]) -> ChunkContent:
        content = ChunkContent(frame.offset, frame.end, places=self._places)
        for record in records:
            self._learn(record)
        messages = [record for record in records if isinstance(record, Message)]
        content.messages = Counter(one.channel_id for one in messages)
        content.is_indexed = frame.opcode == Opcode.MESSAGE or self._is_indexed(content)
        self._learn_from_facts(messages)
        try:
            facts = ReadFacts.decode([one.data for one in messages if self._is_facts(one)])
        except ValueError as error:
            raise FileError(f"the chunk at byte {frame.offset} of {self.path!r} is damaged: {error}") from error
        content.gaps, content.advances = facts.gaps, facts.advances
        facts.unnamed = sum(self._topic_of(one.channel_id) is None for one in messages)
        for message in messages:
            if self._is_facts(message):
                continue
            topic = self._topic_of(message.channel_id)
            if topic is None:
                content.unknown += 1
                continue
            entry = _entry(topic, message, facts)
            content.bare += topic.incarnation is not None and entry.seq is None
            content.entries.append(entry)
        return content

    def _learn_from_facts(self, messages: Sequence[Message]) -> None:
        """Learn topics from the facts at the end of a chunk, if the chunk with the records of the topics is damaged."""
        unnamed = [one for one in messages if self._topic_of(one.channel_id) is None]
        if not unnamed:
            return
        last = messages[-1]
        if unnamed[-1] is last and is_facts(last.data):
            self._topics[last.channel_id] = facts_topic()
            self._facts_ids.add(last.channel_id)
        if last.channel_id in self._facts_ids:
            sequences: dict[int, list[int]] = {}
            named: dict[IncarnationKey, set[int]] = {}
            for one in messages[:-1]:
                if (topic := self._topic_of(one.channel_id)) is None:
                    sequences.setdefault(one.channel_id, []).append(one.sequence)
                else:
                    named.setdefault((topic.name, topic.incarnation), set()).add(one.sequence)
            for number, topic in topics_of(sequences, named, last.data).items():
                self._topics[number] = topic
                self._place(number, topic)

    def _is_facts(self, message: Message) -> bool:
        if message.channel_id not in self._topics:
            self._topic_of(message.channel_id)
        return message.channel_id in self._facts_ids

    def _topic_of(self, number: int) -> Topic | None:
        """Return a topic. If the chunk that names it is damaged, the index at the end of the file names it, too."""
        found = self._topics.get(number)
        if found is None and self.index is not None and (found := self.index.topics.get(number)) is not None:
            self._topics[number] = found
            if found.name == FACTS_TOPIC:
                self._facts_ids.add(number)
        return found


def _entry(topic: Topic, message: Message, facts: ReadFacts) -> FileEntry:
    found = facts.of(topic, message.sequence)
    if found is None:
        return FileEntry(
            topic, message.log_time, message.publish_time, message.sequence, message.data, None, message.log_time,
            None, {}, content_type_of_encoding(topic.encoding),
        )  # fmt: skip
    time = message.log_time if found.time is None else found.time
    return FileEntry(
        topic, message.log_time, message.publish_time, message.sequence, message.data, found.seq, time, found.duration,
        found.attributes, found.content_type,
    )  # fmt: skip
