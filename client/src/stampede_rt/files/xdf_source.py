"""An XDF file as a source of items, through the library `pyxdf`."""

from __future__ import annotations

import heapq
import json
import logging
import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import Event
from stampede_rt.files.entries import FileEntry, Topic
from stampede_rt.files.file_source import Chosen, SourceTopic, is_within, missing_library, unreadable

XDF_BYTES_MAX = 1024**3
"""The largest XDF file. `pyxdf` reads a file as a whole."""
COMPLAINTS_MAX = 8


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
            raise missing_library("pyxdf") from error
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
                raise unreadable(Path(self.path), error) from error
        if complaints.texts:
            raise FileError(f"the file {self.path!r} is damaged: {complaints.texts[0]}")
        for name, stream in found.items():
            if not all(map(math.isfinite, stream["time_stamps"])):
                raise FileError(f"the file {self.path!r} is damaged: a time of stream {name!r} is no finite number")
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
        return min((one for one in stamps if is_within(one, start, end)), default=None)


class _Complaints(logging.Handler):
    """Gathers the errors that a library logs while it skips damaged parts, and keeps them out of the program's log."""

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
        name = _text(stream, "name") or "unnamed"
        while name in names:
            name = f"{name}-{stream['info']['stream_id']}"
        names.append(name)
    return names


def _text(stream: Any, field: str) -> str:
    """Return a text in the header of a stream; empty if the header lacks it."""
    found = stream["info"].get(field) or [None]
    return str(found[0] or "")


def _unfinished(name: str, stream: Any) -> str:
    """Return a text about the missing samples of a stream; empty: none are missing.

    A recorder writes the number of samples last, in the footer of the stream.
    """
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
    kind = _text(stream, "type")
    attributes = {"type": kind} if kind else {}
    value_of: Callable[[Any], Any] = _number if hasattr(stream["time_series"], "dtype") else str
    for seconds, sample in zip(stream["time_stamps"], stream["time_series"], strict=False):
        time = _nanos(seconds)
        if is_within(time, start, end):
            due = max(due, time)
            data = json.dumps([value_of(one) for one in sample], ensure_ascii=False).encode()
            yield due, FileEntry(topic, time, time, 0, data, None, time, None, attributes, "application/json")


def _number(value: Any) -> int | float | None:
    plain = value.item()
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
