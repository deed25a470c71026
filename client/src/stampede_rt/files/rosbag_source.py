"""A rosbag2 as a source of items, through the library `rosbags`."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import Event
from stampede_rt.files.entries import FileEntry, Topic
from stampede_rt.files.file_source import (
    Chosen,
    SourceTopic,
    check_unpacked,
    is_within,
    missing_library,
    time_of_first,
    unreadable,
)
from stampede_rt.values.timeline import MAX_INSTANT

CDR = "application/x-ros-cdr"
READ_NANOS = 10**9
"""The search for the last message of some topics halves an interval until it is at most this long."""


def _check_whole_database(path: Path) -> None:
    """Check that all messages are in the files of SQLite, and none in a journal beside them. Raises FileError.

    The reader of rosbags does not read journals. SQLite leaves one behind if the recorder was killed.
    """
    for file in sorted(path.glob("*.db3")) if path.is_dir() else [path]:
        for journal in (file.with_name(file.name + end) for end in ("-wal", "-journal")):
            if journal.is_file() and journal.stat().st_size:
                raise FileError(
                    f"the bag {os.fspath(path)!r} has messages in {journal.name!r}, because its recorder was killed or "
                    f"still runs; end the recorder, and let SQLite take them over: sqlite3 {file.name} 'VACUUM'"
                )


class RosbagSource:
    """A rosbag2, without ROS. Its messages stay in CDR; the attribute `schema` has the message type."""

    def __init__(self, path: Path) -> None:
        """Open the bag. Raises FileError."""
        try:
            from rosbags.rosbag2 import Reader
        except ImportError as error:
            raise missing_library("rosbags") from error
        self.path = os.fspath(path)
        _check_whole_database(path)
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:
            raise unreadable(path, error) from error
        self._topics: dict[str, Topic] = {}
        self._missing: dict[str, str] = {}
        # The files of a bag, each with its own topics and counts. The reader of one file has none.
        self._files: Sequence[Any] = getattr(self._reader.storage, "storages", ())
        self._unnamed = _unnamed_files(path, {Path(one.path).name for one in self._files}) if self._files else []
        self._is_empty: dict[int, bool] = {}  # for each topic that has no messages by the metadata, by its number

    @property
    def damaged(self) -> Sequence[str]:
        """The files that the metadata does not name, and the topics of which some messages could not be read.

        This property names such a topic only after the caller has read all `events` of the topic.
        """
        return [*self._unnamed, *self._missing.values()]

    def close(self) -> None:
        """Close the bag."""
        if self._reader.is_open:
            self._reader.close()

    def topics(self, chosen: Chosen) -> Sequence[SourceTopic]:
        """The chosen topics that have messages, by name. Each has the times of all chosen topics together."""
        filled = [one for one in self._reader.connections if self._has_messages(one)]
        connections = [one for one in filled if chosen(one.topic)]
        names = sorted({one.topic for one in connections})
        start, end = self._reader.start_time, max(self._reader.end_time - 1, self._reader.start_time)
        if self._has_others(connections, start, end):
            start, end = self._times(connections, 0, MAX_INSTANT - 1)
        elif names and len(names) < len({one.topic for one in filled}):
            start, end = self._times(connections, start, end)
        return [SourceTopic(name=name, policy={}, start=start, end=end) for name in names]

    def _has_messages(self, connection: Any) -> bool:
        """Whether a topic has messages. The counts in the metadata of a bag may be wrong."""
        if connection.msgcount:
            return True
        if connection.id not in self._is_empty:
            self._is_empty[connection.id] = self._a_time_or_none([connection], 0, MAX_INSTANT) is None
        return not self._is_empty[connection.id]

    def _has_others(self, connections: Sequence[Any], start: int, end: int) -> bool:
        """Whether there are messages that are not in the interval from `start` to `end`, which the metadata states."""
        outside = ((0, start), (end + 1, MAX_INSTANT))
        return bool(connections) and any(self._a_time_or_none(connections, *one) is not None for one in outside)

    def _times(self, connections: Sequence[Any], start: int, end: int) -> tuple[int, int]:
        """The first and last time of some topics, in a bag from `start` to `end`.

        A bag has no index by topic. So the search for the last time halves an interval. It reads one message in each
        step, and at the end all messages of the last READ_NANOS.
        """
        try:
            last = self._a_time(connections, start, end + 1)
            first = self._least_time(connections, start, last)
            if first is None or last is None:
                return start, end
            after = end + 1
            while after - last > READ_NANOS:
                middle = (last + after) // 2
                found = self._a_time(connections, middle, after)
                last, after = (last, middle) if found is None else (found, after)
            return first, max(time for _, time, _ in self._reader.messages(connections, last, after))
        except Exception:  # noqa: BLE001  # `events` raises it if it reads the same messages
            return start, end

    def _least_time(self, connections: Sequence[Any], start: int, found: int | None) -> int | None:
        """The least time of a message from `start` on, if there is one at the time `found`.

        A bag of several files gives the messages file by file, and their times may overlap.
        """
        while found is not None and (earlier := self._a_time(connections, start, found)) is not None:
            found = earlier
        return found

    def _a_time_or_none(self, connections: Sequence[Any], start: int, end: int) -> int | None:
        try:
            return self._a_time(connections, start, end)
        except Exception:  # noqa: BLE001  # `events` raises it if it reads the same messages
            return None

    def _a_time(self, connections: Sequence[Any], start: int, end: int) -> int | None:
        """The time of a message from `start` on and before `end`; None: there is none."""
        return next((time for _, time, _ in self._reader.messages(connections, start, end)), None)

    def events(self, chosen: Chosen, start: int, end: int) -> Iterator[tuple[int, Event]]:
        """Yield the messages in the order of the bag. Raises FileError."""
        connections = [one for one in self._reader.connections if chosen(one.topic)]
        due, counts = start, Counter[str]()
        try:
            for connection, time, data in self._reader.messages(connections) if connections else ():
                counts[connection.topic] += 1
                if is_within(time, start, end):
                    due, entry = max(due, time), self._entry(connection, time, bytes(data))
                    check_unpacked(self.path, entry)
                    yield due, entry
        except FileError:
            raise
        except Exception as error:
            raise unreadable(Path(self.path), error) from error
        stated = _counts(connections) | _counts(
            one for file in self._files for one in file.connections if chosen(one.topic)
        )
        for topic, missing in (stated - counts).items():
            self._missing[topic] = f"{missing} of the {stated[topic]} messages of topic {topic!r}"

    def first_time(self, name: str, start: int, end: int) -> int | None:
        """See `FileSource.first_time`. Raises FileError."""
        found = time_of_first(self, name, start, end)
        try:
            return self._least_time([one for one in self._reader.connections if one.topic == name], start, found)
        except Exception as error:
            raise unreadable(Path(self.path), error) from error

    def _entry(self, connection: Any, time: int, data: bytes) -> FileEntry:
        topic = self._topics.setdefault(connection.topic, Topic(connection.topic, "cdr"))
        return FileEntry(topic, time, time, 0, data, None, time, None, {"schema": connection.msgtype}, CDR)


def _counts(connections: Iterable[Any]) -> Counter[str]:
    """Return the stated number of messages of each topic."""
    found = Counter[str]()
    for one in connections:
        found[one.topic] += one.msgcount
    return found


def _unnamed_files(folder: Path, named: Collection[str]) -> list[str]:
    """Return a text for each file of a bag that its metadata does not name. A recorder writes the metadata last."""
    ends = tuple({Path(one).suffix for one in named})
    others = [one.name for one in sorted(folder.iterdir()) if one.name.removesuffix(".zstd").endswith(ends)]
    return [
        f"the messages in the file {name!r}, which the metadata.yaml of the bag does not name"
        for name in others
        if name.removesuffix(".zstd") not in named
    ]
