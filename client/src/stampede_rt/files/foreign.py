"""Files of other programs as sources of items: rosbag2 through `rosbags`, and XDF through `pyxdf`."""

from __future__ import annotations

import heapq
import json
import logging
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import Event
from stampede_rt.files.entries import FileEntry, Topic
from stampede_rt.files.file_source import Chosen, FileSource, SourceTopic, check_unpacked, time_of_first
from stampede_rt.files.framing import MAGIC
from stampede_rt.files.sources import McapSource

CDR = "application/x-ros-cdr"
XDF_BYTES_MAX = 1024**3
"""The largest XDF file. `pyxdf` reads a file as a whole."""
COMPLAINTS_MAX = 8
READ_NANOS = 10**9
"""The search for the last message of chosen topics of a rosbag2 halves the time down to this length."""
_XDF_MAGIC = b"XDF:"
_SQLITE_MAGIC = b"SQLite format 3\x00"


def source_of(path: str | os.PathLike[str]) -> FileSource:
    """Open a file as a source, by its content. Raises FileError."""
    found = Path(path)
    if found.is_dir() and not (found / "metadata.yaml").is_file():
        raise FileError(f"{os.fspath(path)!r} is a folder, and no rosbag2: it has no metadata.yaml; name a file")
    if found.is_dir():
        return RosbagSource(found)
    try:
        with found.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise FileError(f"the file {os.fspath(path)!r} cannot be read: {error.strerror}") from error
    if head.startswith(MAGIC):
        return McapSource(found)
    if head == _SQLITE_MAGIC:
        return RosbagSource(found)
    if head.startswith(_XDF_MAGIC):
        return XdfSource(found)
    raise FileError(
        f"the file {os.fspath(path)!r} is neither MCAP, nor rosbag2, nor XDF; unpack a packed file (.xdfz, .zstd) "
        "first, or name the folder of a rosbag2"
    )


def _missing(library: str) -> FileError:
    return FileError(f"this file needs the library {library}; run: pip install 'stampede-rt[imports]'")


def _unreadable(path: Path, error: BaseException) -> FileError:
    return FileError(
        f"the file {os.fspath(path)!r} cannot be read; it may be damaged: {str(error) or type(error).__name__}"
    )


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
            raise _missing("rosbags") from error
        self.path = os.fspath(path)
        _check_whole_database(path)
        try:
            self._reader = Reader(path)
            self._reader.open()
        except Exception as error:
            raise _unreadable(path, error) from error
        self._topics: dict[str, Topic] = {}
        self._missing: dict[str, str] = {}

    @property
    def damaged(self) -> Sequence[str]:
        """The topics of which the bag has fewer messages than its metadata says; known after their `events`."""
        return [*self._missing.values()]

    def close(self) -> None:
        """Close the bag."""
        if self._reader.is_open:
            self._reader.close()

    def topics(self, chosen: Chosen) -> Sequence[SourceTopic]:
        """The chosen topics that have messages, by name. Each has the times of all chosen topics together."""
        connections = [one for one in self._reader.connections if one.msgcount and chosen(one.topic)]
        names = sorted({one.topic for one in connections})
        start, end = self._reader.start_time, max(self._reader.end_time - 1, self._reader.start_time)
        if names and len(names) < len({one.topic for one in self._reader.connections if one.msgcount}):
            start, end = self._times(connections, start, end)
        return [SourceTopic(name=name, policy={}, start=start, end=end) for name in names]

    def _times(self, connections: Sequence[Any], start: int, end: int) -> tuple[int, int]:
        """The first and last time of some topics, in a bag from `start` to `end`.

        A bag has no index by topic. So this reads few messages of these topics, and at the end those of a second.
        """
        try:
            first = last = self._a_time(connections, start, end + 1)
            while first is not None and (earlier := self._a_time(connections, start, first)) is not None:
                first = earlier  # a bag of several files gives the messages file by file
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
                if start <= time < end:
                    due, entry = max(due, time), self._entry(connection, time, bytes(data))
                    check_unpacked(self.path, entry)
                    yield due, entry
        except FileError:
            raise
        except Exception as error:
            raise _unreadable(Path(self.path), error) from error
        stated = Counter[str]()
        for connection in connections:
            stated[connection.topic] += connection.msgcount
        for topic, missing in (stated - counts).items():
            self._missing[topic] = f"{missing} of the {stated[topic]} messages of topic {topic!r}"

    def first_time(self, name: str, start: int, end: int) -> int | None:
        """See `FileSource.first_time`. The times of a bag rise."""
        return time_of_first(self, name, start, end)

    def _entry(self, connection: Any, time: int, data: bytes) -> FileEntry:
        topic = self._topics.setdefault(connection.topic, Topic(connection.topic, "cdr"))
        return FileEntry(topic, time, time, 0, data, None, time, None, {"schema": connection.msgtype}, CDR)


class XdfSource:
    """An XDF file (LabRecorder). Each sample is an item: a JSON list with the value of each of the stream's channels.

    Times come from the recording computer's clock, as `pyxdf` corrects them: seconds since its start, not since the
    epoch. Values that JSON has no number for become null.
    """

    def __init__(self, path: Path) -> None:
        """Read the file. Raises FileError."""
        try:
            import pyxdf
        except ImportError as error:
            raise _missing("pyxdf") from error
        self.path = os.fspath(path)
        if path.stat().st_size > XDF_BYTES_MAX:
            raise FileError(f"the file {self.path!r} is larger than 1 GiB, and XDF is read as a whole; split it first")
        self._streams = self._load(pyxdf.load_xdf)
        self.damaged: Sequence[str] = [
            text for name, stream in self._streams.items() if (text := _unfinished(name, stream))
        ]

    def _load(self, load: Callable[[str], Any]) -> dict[str, Any]:
        with _Complaints("pyxdf") as complaints:
            try:
                streams, _ = load(self.path)
                found = dict(zip(_names_of(streams), streams, strict=True))
            except Exception as error:
                raise _unreadable(Path(self.path), error) from error
        if complaints.texts:
            raise FileError(f"the file {self.path!r} is damaged: {complaints.texts[0]}")
        return found

    def close(self) -> None:
        """Forget the file."""
        self._streams = {}

    def topics(self, chosen: Chosen) -> Sequence[SourceTopic]:
        """The chosen streams that have samples, by name."""
        found = []
        for name, stream in sorted(self._streams.items()):
            stamps = stream["time_stamps"]
            if chosen(name) and len(stamps):
                start, end = _nanos(min(stamps)), _nanos(max(stamps))
                found.append(SourceTopic(name=name, policy={}, start=start, end=end))
        return found

    def events(self, chosen: Chosen, start: int, end: int) -> Iterator[tuple[int, Event]]:
        """Yield the samples of all chosen streams, merged by time."""
        many = [_samples(name, stream, start, end) for name, stream in sorted(self._streams.items()) if chosen(name)]
        yield from heapq.merge(*many, key=lambda one: one[0])

    def first_time(self, name: str, start: int, end: int) -> int | None:
        """See `FileSource.first_time`. The stamps of a stream may fall where the clock of its device was reset."""
        stamps = [_nanos(one) for one in self._streams[name]["time_stamps"]]
        return min((one for one in stamps if start <= one < end), default=None)


class _Complaints(logging.Handler):
    """Gathers the errors that a library logs while it skips damaged parts. The log itself gets nothing."""

    def __init__(self, name: str) -> None:
        super().__init__(logging.ERROR)
        self._logger = logging.getLogger(name)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the first texts."""
        if len(self.texts) < COMPLAINTS_MAX:
            self.texts.append(record.getMessage())

    def __enter__(self) -> _Complaints:
        self._logger.addHandler(self)
        self._propagated, self._logger.propagate = self._logger.propagate, False
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self)
        self._logger.propagate = self._propagated


def _names_of(streams: Sequence[Any]) -> list[str]:
    """Return a name for each stream. Streams with the same name get a number."""
    names: list[str] = []
    for stream in streams:
        name = str(stream["info"]["name"][0] or "unnamed")
        while name in names:
            name = f"{name}-{stream['info']['stream_id']}"
        names.append(name)
    return names


def _unfinished(name: str, stream: Any) -> str:
    """Return the samples that a file lacks of a stream; empty: none. A recorder writes the number of samples last."""
    footer = stream.get("footer")
    if footer is None:
        return (
            f"perhaps the last samples of stream {name!r}: the file lacks the footer of the stream, so its recorder "
            "was killed, or the file was cut off"
        )
    try:
        stated = int(footer["info"]["sample_count"][0])
    except (KeyError, TypeError, ValueError, IndexError):
        return ""
    missing = stated - len(stream["time_stamps"])
    return f"{missing} of the {stated} samples of stream {name!r}" if missing > 0 else ""


def _nanos(seconds: float) -> int:
    return round(float(seconds) * 1e9)


def _samples(name: str, stream: Any, start: int, end: int) -> Iterator[tuple[int, Event]]:
    topic, due = Topic(name, "json"), start
    kind = str(stream["info"]["type"][0] or "")
    attributes = {"type": kind} if kind else {}
    value_of: Callable[[Any], Any] = _number if hasattr(stream["time_series"], "dtype") else str
    for seconds, sample in zip(stream["time_stamps"], stream["time_series"], strict=False):
        time = _nanos(seconds)
        if start <= time < end:
            due = max(due, time)
            data = json.dumps([value_of(one) for one in sample], ensure_ascii=False).encode()
            yield due, FileEntry(topic, time, time, 0, data, None, time, None, attributes, "application/json")


def _number(value: Any) -> int | float | None:
    plain = value.item()
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
