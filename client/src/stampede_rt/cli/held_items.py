"""The items that channels hold, in memory and in their archives, as a temporary MCAP file."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from stampede_rt.cli.arguments import connected
from stampede_rt.cli.exit_statuses import INCOMPLETE
from stampede_rt.cli.output import joined
from stampede_rt.cli.progress import shown_progress
from stampede_rt.cli.record import recording_progress
from stampede_rt.errors import FileError, InvalidArgument, Unavailable
from stampede_rt.escaping import escaped
from stampede_rt.files.schedule import window_text
from stampede_rt.values.peering import ClockOffset
from stampede_rt.values.recording import RecordingSummary
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT


@contextmanager
def file_with_items_of(
    arguments: argparse.Namespace,
    sources: Sequence[str],
    folder: Path | None = None,
    *,
    from_start: bool = False,
    needs_items: bool = True,
) -> Iterator[tuple[str, int]]:
    """Yield the path of a file with the items of `sources`, and a status: 0, or INCOMPLETE if items are missing.

    If the only source is an existing file, yields this file and status 0. Otherwise the sources are names of channels,
    or globs. The command then writes a file below `folder` (None: the folder for temporary files), and deletes it at
    the end. With `from_start` it leaves most items before --from out. Raises InvalidArgument if there is neither a file
    nor a channel; with `needs_items` also if the channels have no items from --from on and before --to.
    """
    if len(sources) == 1 and os.path.exists(sources[0]):
        yield sources[0], 0
        return
    from stampede_rt.files.writing import PART_SUFFIX

    with tempfile.TemporaryDirectory(prefix=".stampede-held-", dir=folder) as made:
        path = Path(made) / f"held.mcap{PART_SUFFIX}"  # an error then says that no file stays
        try:
            summary = _record(arguments, sources, path, arguments.start if from_start else None)
        except FileError as error:
            raise _not_copied(error, folder) from error
        if needs_items:
            _check_items(summary, path, arguments.start, arguments.end)
        yield str(path), 0 if summary.complete else INCOMPLETE


def _not_copied(error: FileError, folder: Path | None) -> FileError:
    where = "; $TMPDIR names the folder for it" if folder is None else ""
    return FileError(f"the items of the channels do not fit into a temporary file: {error.message}{where}")


def since_of(start: int | None, now: int, clock: ClockOffset | None) -> str:
    """Return the argument `since` of `Connection.record`, for a recording that has the items from `start` on.

    `now`: the time of this machine's clock, which may be wrong. `clock`: how far this machine's clock is ahead of the
    cluster's clock; None: this is not known.
    """
    if start is None or clock is None:
        return "oldest"
    return f"{max(0, now - start) + clock.apart_nanos} ns"


def _record(arguments: argparse.Namespace, sources: Sequence[str], path: Path, start: int | None) -> RecordingSummary:
    with (
        connected(arguments) as rt,
        rt.record(sources, path, since=since_of(start, time.time_ns(), rt.clock), for_="0s") as recorder,
        shown_progress(recording_progress(recorder, None)),
    ):
        summary = recorder.wait()
    assert summary is not None, "`wait` without a timeout returns the summary"
    for text in summary.absent if summary.channels else ():
        print(f"stampede: missing: {escaped(text)}", file=sys.stderr)
    if not summary.channels and recorder.channels:
        raise Unavailable(f"no items of {joined(recorder.channels)} could be read; {summary.absent[-1]}")
    if not summary.channels:
        raise InvalidArgument(f"there is no file and no channel {' '.join(sources)}; `stampede ls` lists the channels")
    return summary


def _check_items(summary: RecordingSummary, path: Path, start: int | None, end: int | None) -> None:
    """Raise InvalidArgument if no channel has an item from `start` on and before `end`."""
    first, last = MIN_INSTANT if start is None else start, MAX_INSTANT if end is None else end
    ends = [(one.start, one.end) for one in summary.channels if one.start is not None and one.end is not None]
    if any(start < last and end >= first for start, end in ends) and _has_items(path, first, last):
        return
    names = sorted({one.channel for one in summary.channels})
    has = f"channel {names[0]!r} has" if len(names) == 1 else f"the channels {joined(names)} have"
    whys = [f": {gap.reason}: {gap.detail}" for one in summary.channels for gap in one.gaps]
    raise InvalidArgument(f"{has} no items{window_text(start, end)}{whys[0] if whys else ''}")


def _has_items(path: Path, start: int, end: int) -> bool:
    """Whether a file has an item from `start` on and before `end`."""
    from stampede_rt.files.entries import FileEntry
    from stampede_rt.files.sources import McapSource

    with closing(McapSource(path)) as source:
        return any(isinstance(event, FileEntry) for _, event in source.events(lambda name: True, start, end))
