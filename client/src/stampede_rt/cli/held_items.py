"""The items that channels hold, in memory and in their archives, as a temporary MCAP file."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from stampede_rt.cli.arguments import connected
from stampede_rt.cli.exit_statuses import INCOMPLETE
from stampede_rt.cli.output import joined
from stampede_rt.cli.progress import shown_progress
from stampede_rt.cli.record import recording_progress
from stampede_rt.errors import InvalidArgument
from stampede_rt.escaping import escaped
from stampede_rt.values.recording import RecordingSummary
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, format_instant


@contextmanager
def file_of(
    arguments: argparse.Namespace,
    sources: Sequence[str],
    folder: Path | None,
    since: str = "oldest",
    *,
    needs_items: bool = True,
) -> Iterator[tuple[str, int]]:
    """Yield the path of a file with the items of `sources`, and a status: 0, or INCOMPLETE if items are missing.

    If the only source is an existing file, yields this file and status 0. Otherwise the sources are names of channels,
    or globs. The command then writes a file below `folder` (None: the folder for temporary files), and deletes it at
    the end. `since`: as in
    `Connection.record`. Raises InvalidArgument if there is neither a file nor a channel; with `needs_items` also if the
    channels have no items from --from on and before --to.
    """
    if len(sources) == 1 and os.path.exists(sources[0]):
        yield sources[0], 0
        return
    with tempfile.TemporaryDirectory(prefix=".stampede-held-", dir=folder) as made:
        path = Path(made) / "held.mcap"
        summary = _record(arguments, sources, path, since)
        if needs_items:
            _check_items(summary, arguments.start, arguments.end)
        yield str(path), 0 if summary.complete else INCOMPLETE


def _record(arguments: argparse.Namespace, sources: Sequence[str], path: Path, since: str) -> RecordingSummary:
    with (
        connected(arguments) as rt,
        rt.record(sources, path, since=since, for_="0s") as recorder,
        shown_progress(recording_progress(recorder, None)),
    ):
        summary = recorder.wait()
    assert summary is not None, "the recording has no limit of time here"
    for text in summary.absent:
        print(f"stampede: missing: {escaped(text)}", file=sys.stderr)
    if not summary.channels:
        raise InvalidArgument(f"there is no file and no channel {' '.join(sources)}; `stampede ls` lists them")
    return summary


def _check_items(summary: RecordingSummary, start: int | None, end: int | None) -> None:
    """Raise InvalidArgument if no channel has an item from `start` on and before `end`."""
    first, last = MIN_INSTANT if start is None else start, MAX_INSTANT if end is None else end - 1
    for one in summary.channels:
        if one.start is not None and one.end is not None and one.start <= last and one.end >= first:
            return
    names = sorted({one.channel for one in summary.channels})
    has = f"channel {names[0]!r} has" if len(names) == 1 else f"the channels {joined(names)} have"
    since = "" if start is None else f" from {format_instant(start)} on"
    until = "" if end is None else f"{' and' if since else ''} before {format_instant(end)}"
    whys = [f": {gap.reason}: {gap.detail}" for one in summary.channels for gap in one.gaps]
    raise InvalidArgument(f"{has} no items{since}{until}{whys[0] if whys else ''}")
