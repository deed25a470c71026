"""Reads whole files and refuses damaged ones. Also collects the losses that files report, for a file made of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypedDict

from mcap.records import Attachment, Metadata

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import ChunkContent
from stampede_rt.files.file_index import ContentCounts
from stampede_rt.files.framing import Damage
from stampede_rt.files.reading import FileReader

LOSSES_MAX = 1000
"""The most texts of `RecordingSummary.damaged`."""


class UnnamedLosses(TypedDict):
    """The reported losses for which a file has no gap record, see `RecordingSummary`."""

    absent: tuple[str, ...]
    damaged: tuple[str, ...]


def losses_of(readers: Iterable[FileReader]) -> UnnamedLosses:
    """Return the losses that the files report, each once, for a new file made of these files. Raises FileError."""
    summaries = [summary for one in readers if (summary := one.summary())]
    absent = dict.fromkeys(text for summary in summaries for text in summary.absent)
    damaged = dict.fromkeys(text for summary in summaries for text in summary.damaged)
    return UnnamedLosses(absent=tuple(absent)[:LOSSES_MAX], damaged=tuple(damaged)[:LOSSES_MAX])


def intact_contents(reader: FileReader) -> Iterator[ChunkContent | Attachment | Metadata]:
    """Yield the chunks, attachments and metadata of a file.

    Raises FileError at the first damage, at a message whose topic the file does not name, if the end of the file is
    missing, and at the end if the contents do not agree with the index or with the checksum of the file.
    """
    counts = ContentCounts()
    if reader.index is None and not reader.says_no_index:
        raise _without_end(reader)
    for part in reader.contents():
        if isinstance(part, Damage):
            raise FileError(
                f"the file {reader.path!r} is damaged at byte {part.offset}: {part.detail}; "
                "`stampede file recover` saves the readable part"
            )
        if isinstance(part, ChunkContent):
            reader.check(part)
            if reader.index is None and any(one.topic.incarnation is not None for one in part.entries):
                raise _without_end(reader)  # a recording has an index
        counts.add(part)
        yield part
    wrong = counts.differences(reader.index, skip_own_channels=False)
    if not reader.data_is_whole:
        wrong.append("its bytes do not have the checksum that it states")
    if wrong:
        raise FileError(
            f"the file {reader.path!r} is damaged, and may lack items: {wrong[0]}; `stampede file recover` saves the "
            "readable part"
        )


def _without_end(reader: FileReader) -> FileError:
    return FileError(
        f"the end of the file {reader.path!r} is missing or damaged, so it may lack items; `stampede file recover` "
        "saves the readable part"
    )
