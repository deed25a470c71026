"""The interface of the files from which a replay or an import puts items, and their common checks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import Event
from stampede_rt.files.entries import FileEntry
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT

TOPICS_NAMED = 5  # the most topics that an error names
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
Chosen = Callable[[str], bool]  # whether the caller wants the topic of this name


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceTopic:
    """A topic of a source: its name, and the policy of its channel if the source knows it.

    `start` and `end` are its first and last time. A source that does not know the times of each topic gives the times
    of all its chosen topics together.
    """

    name: str
    policy: Mapping[str, Any]
    start: int
    end: int


def none_chosen(source: FileSource) -> str:
    """Return the text of the error if no topic of a file is chosen. It names some topics."""
    topics = source.topics(lambda _: True)
    names = ", ".join(repr(one.name) for one in topics[:TOPICS_NAMED]) or "no topics"
    more = f" and {len(topics) - TOPICS_NAMED} more" if len(topics) > TOPICS_NAMED else ""
    return f"the file {source.path!r} has none of the chosen topics; it has {names}{more}"


def check_unpacked(path: str, entry: FileEntry) -> None:
    """Check that a message is not compressed. Raises FileError.

    Rosbag2 can compress each message separately. Only the `metadata.yaml` of the bag says this. CDR is the encoding of
    ROS messages, and no message in CDR begins with the magic number of zstd.
    """
    if entry.topic.encoding == "cdr" and entry.seq is None and entry.data.startswith(_ZSTD_MAGIC):
        raise FileError(
            f"the file {path!r} has compressed messages of a rosbag2; name the folder of the bag, whose metadata.yaml "
            "says so"
        )


class FileSource(Protocol):
    """A file from which a program puts items. `events` yields each event with a time, and these times never fall."""

    path: str

    @property
    def damaged(self) -> Sequence[str]:
        """The items or channels that the file may lack, besides the gaps that `events` yields."""
        ...

    def topics(self, chosen: Chosen) -> Sequence[SourceTopic]:
        """The chosen topics that have messages, by name."""
        ...

    def events(self, chosen: Chosen, start: int, end: int) -> Iterator[tuple[int, Event]]:
        """Yield the items with a time from `start` on and before `end`, and the gaps and advances between them."""
        ...

    def first_time(self, name: str, start: int, end: int) -> int | None:
        """The least time of the items of a topic from `start` on and before `end`; None: there are none."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


def time_of_first(source: FileSource, name: str, start: int, end: int) -> int | None:
    """The time of the first item of a topic in an interval; None: there is none."""
    events = source.events(lambda one: one == name, start, end)
    return next((event.time for _, event in events if isinstance(event, FileEntry)), None)


def missing_library(library: str) -> FileError:
    """Return the error for a file that needs a library."""
    return FileError(f"this file needs the library {library}; run: pip install 'stampede-rt[imports]'")


def unreadable(path: Path, error: BaseException) -> FileError:
    """Return the error for a file that a library cannot read."""
    return FileError(
        f"the file {os.fspath(path)!r} cannot be read; it may be damaged: {str(error) or type(error).__name__}"
    )


def is_within(time: int, start: int, end: int) -> bool:
    """Whether a time is in an interval. MIN_INSTANT and MAX_INSTANT: the interval has no start, or no end."""
    return (start <= time or start == MIN_INSTANT) and (time < end or end == MAX_INSTANT)
