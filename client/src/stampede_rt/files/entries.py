"""The contents of a file: topics, messages, gaps and advances, and the facts that MCAP has no field for. Pure.

The facts of the messages in a chunk are one more message of that chunk, in JSON, on the topic `stampede/facts`.
docs/files.md describes this JSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from stampede_rt.files.json_text import read_json
from stampede_rt.values.model import Item
from stampede_rt.values.recording import RecordingGap, incarnation_of, whole_number

FACTS_TOPIC = "stampede/facts"
FACTS_VERSION = 1
INCARNATION_KEY = "stampede.incarnation"  # in the metadata of a topic
POLICY_KEY = "stampede.policy"
SEQUENCE_MASK = 2**32 - 1  # MCAP has the lower 32 bits of a seq
TIME_MAX = 2**64 - 1  # the greatest time in MCAP, in nanoseconds
_CONTENT_TYPES = {"json": "application/json", "protobuf": "application/x-protobuf", "": ""}
_ENCODINGS = {"application/json": "json", "application/x-protobuf": "", "": "application/octet-stream"}


@dataclass(frozen=True, slots=True)
class Schema:
    """The schema of a topic in MCAP."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a file: a channel of Stampede RT (with an incarnation), or of another program (without)."""

    name: str
    encoding: str
    incarnation: int | None = None
    schema: Schema | None = None
    metadata: tuple[tuple[str, str], ...] = ()


class FileEntry(NamedTuple):
    """One message of a file. `seq` is None for a message without facts; the fields after it are then defaults."""

    topic: Topic
    log_time: int
    publish_time: int
    sequence: int
    data: bytes
    seq: int | None
    time: int
    duration: int | None
    attributes: Mapping[str, str]
    content_type: str

    def to_item(self) -> Item:
        """Return the message as an item."""
        seq = self.sequence if self.seq is None else self.seq
        end = None if self.duration is None else self.time + self.duration
        return Item(
            self.time, end, self.duration, seq, self.data, self.attributes, self.content_type, len(self.data),
            self.topic.incarnation or 0,
        )  # fmt: skip


class FileAdvance(NamedTuple):
    """A promise of a channel's producers: nothing earlier than `time` comes after the item `after_seq`."""

    channel: str
    incarnation: int
    time: int
    after_seq: int


def encoding_of(content_type: str) -> str:
    """Return the message encoding of MCAP for a content type."""
    return _ENCODINGS.get(content_type, content_type)


def content_type_of_encoding(encoding: str) -> str:
    """Return the content type for a message encoding of MCAP."""
    known = _CONTENT_TYPES.get(encoding)
    if known is not None:
        return known
    return encoding if "/" in encoding else f"application/x-{encoding}"


def item_entry(topic: Topic, item: Item) -> FileEntry:
    """Return an item as a message. The message's times in MCAP are the item's time, if MCAP can express it."""
    shown = min(max(item.time, 0), TIME_MAX)
    return FileEntry(
        topic, shown, shown, item.seq & SEQUENCE_MASK, item.payload or b"", item.seq, item.time, item.duration,
        item.attributes, item.content_type,
    )  # fmt: skip


@dataclass(slots=True)
class _Run:
    """Items with adjacent seqs, and with the same attributes and content type."""

    topic: str
    incarnation: int
    first_seq: int
    content_type: str
    attributes: Mapping[str, str]
    durations: list[int | None] = field(default_factory=list)
    times: list[int | None] = field(default_factory=list)  # None: MCAP's log time is the item's time

    def takes(self, entry: FileEntry) -> bool:
        return (
            entry.seq == self.first_seq + len(self.durations)
            and entry.content_type == self.content_type
            and entry.attributes == self.attributes
        )

    def to_json(self) -> dict[str, Any]:
        value: dict[str, Any] = {
            "topic": self.topic,
            "incarnation": str(self.incarnation),
            "first_seq": self.first_seq,
            "count": len(self.durations),
            "content_type": self.content_type,
            "attributes": dict(self.attributes),
        }
        same = all(one == self.durations[0] for one in self.durations)
        value |= {"duration": self.durations[0]} if same else {"durations": self.durations}
        return value if all(time is None for time in self.times) else value | {"times": self.times}


class ChunkFacts:
    """Gathers the facts of one chunk while it is written."""

    def __init__(self) -> None:
        self._runs: list[_Run] = []
        self._latest: dict[tuple[str, int], _Run] = {}
        self.gaps: list[RecordingGap] = []
        self.advances: list[FileAdvance] = []

    def add(self, entry: FileEntry) -> None:
        """Note the facts of a message of a channel of Stampede RT."""
        incarnation = entry.topic.incarnation
        if incarnation is None or entry.seq is None:
            return
        key = (entry.topic.name, incarnation)
        run = self._latest.get(key)
        if run is None or not run.takes(entry):
            run = _Run(entry.topic.name, incarnation, entry.seq, entry.content_type, entry.attributes)
            self._latest[key] = run
            self._runs.append(run)
        run.durations.append(entry.duration)
        run.times.append(None if entry.time == entry.log_time else entry.time)

    def encoded(self) -> bytes | None:
        """Return the facts as JSON; None if there are none."""
        if not (self._runs or self.gaps or self.advances):
            return None
        advances = [one._asdict() | {"incarnation": str(one.incarnation)} for one in self.advances]
        value = {
            "version": FACTS_VERSION,
            "runs": [run.to_json() for run in self._runs],
            "gaps": [gap.to_json() for gap in self.gaps],
            "advances": advances,
        }
        return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()


class ItemFacts(NamedTuple):
    """The facts of one message."""

    seq: int
    duration: int | None
    attributes: Mapping[str, str]
    content_type: str
    time: int | None


@dataclass(slots=True)
class ReadFacts:
    """The facts of one chunk, as read. `of` gives the facts of the next message of a topic.

    `unnamed` messages of the chunk are of topics that the file does not name. `of` skips at most as many facts.
    """

    gaps: list[RecordingGap] = field(default_factory=list)
    advances: list[FileAdvance] = field(default_factory=list)
    unnamed: int = 0
    _runs: dict[tuple[str, int], Iterator[ItemFacts]] = field(default_factory=dict)

    @classmethod
    def decode(cls, messages: Sequence[bytes]) -> ReadFacts:
        """Return the facts in the facts messages of one chunk. Raises ValueError if they are damaged or hostile."""
        found = cls()
        runs: dict[tuple[str, int], list[Mapping[str, Any]]] = {}
        try:
            for message in messages:
                found._take(read_json(message), runs)
        except (KeyError, TypeError, AttributeError, RecursionError, UnicodeDecodeError) as error:
            raise ValueError(f"the facts of a chunk cannot be read: {type(error).__name__}: {error}") from error
        found._runs = {key: _expanded(parts) for key, parts in runs.items()}
        return found

    def _take(self, value: Mapping[str, Any], runs: dict[tuple[str, int], list[Mapping[str, Any]]]) -> None:
        if value["version"] != FACTS_VERSION:
            raise ValueError(f"the facts have version {value['version']!r}; a later release wrote them")
        self.gaps += [RecordingGap.from_json(gap) for gap in value["gaps"]]
        self.advances += [_advance(one) for one in value["advances"]]
        for run in value["runs"]:
            runs.setdefault((str(run["topic"]), incarnation_of(run["incarnation"])), []).append(run)

    def of(self, topic: Topic, sequence: int) -> ItemFacts | None:
        """Return the facts of the next message of `topic`; None if there are none that fit its `sequence`."""
        if topic.incarnation is None or (facts := self._runs.get((topic.name, topic.incarnation))) is None:
            return None
        found = next(facts, None)
        while found is not None and found.seq & SEQUENCE_MASK != sequence and self.unnamed:
            found, self.unnamed = next(facts, None), self.unnamed - 1
        if found is None or found.seq & SEQUENCE_MASK != sequence:  # another program has moved messages
            self._runs.pop((topic.name, topic.incarnation), None)
            return None
        return found


def _advance(value: Mapping[str, Any]) -> FileAdvance:
    return FileAdvance(
        str(value["channel"]),
        incarnation_of(value["incarnation"]),
        whole_number(value["time"]),
        whole_number(value["after_seq"]),
    )


def _expanded(runs: Iterable[Mapping[str, Any]]) -> Iterator[ItemFacts]:
    """Yield the facts of each item. A damaged run ends them."""
    for run in runs:
        try:
            count, first_seq = whole_number(run["count"]), whole_number(run["first_seq"])
            attributes = {str(key): str(value) for key, value in run["attributes"].items()}
            kind, durations, times = str(run["content_type"]), run.get("durations"), run.get("times")
        except (KeyError, TypeError, ValueError, AttributeError):
            return
        for index in range(count):
            try:
                duration = _at(durations, index, run.get("duration"))
                time = _at(times, index, None)
            except (IndexError, TypeError):
                return
            yield ItemFacts(first_seq + index, duration, attributes, kind, time)


def _at(column: Any, index: int, every: Any) -> int | None:
    """Return a number of a column; `every` if there is no column. Raises TypeError for anything else."""
    found = every if column is None else column[index]
    if found is not None and (type(found) is not int or not -(2**63) <= found < 2**63):
        raise TypeError(f"{str(found)[:40]!r} is not a number of nanoseconds")
    return found
