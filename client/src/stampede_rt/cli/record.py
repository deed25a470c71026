"""`stampede record`: records channels to a file. With `--on` it writes a file for each item (event) of a channel."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_summary, add_verb, connected, existing_channel
from stampede_rt.cli.exit_statuses import INCOMPLETE
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.interrupts import interruption
from stampede_rt.cli.output import bytes_text, joined, print_document, print_rows
from stampede_rt.cli.progress import Progress, shown_progress
from stampede_rt.errors import FileError, IncarnationLost, InvalidArgument, StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.values.policy import duration_of
from stampede_rt.values.recording import RecordedCounts, RecordingGap, RecordingSummary
from stampede_rt.values.timeline import NOW, OLDEST, Bound, format_duration, parse_duration

if TYPE_CHECKING:
    from stampede_rt import Connection
    from stampede_rt._sync.recorder import Recorder
    from stampede_rt.values.model import Item

PARALLEL_RECORDINGS_MAX = 4  # recordings of `--on` at the same time
STOP_DRAIN_S = 1.0  # the wait, after Ctrl-C, for items that the hosts had accepted before Ctrl-C
STOP_S = 15.0  # after Ctrl-C the command waits at most this time for the end of the file
GAPS_SHOWN = 20  # the most gaps of each channel that the command prints


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    record = add_verb(subparsers, "record", "record channels to an MCAP file, until Ctrl-C", run_record, output=False)
    record.add_argument("channels", nargs="+", metavar="CHANNEL", help="a name, or a glob such as 'rig/*'")
    record.add_argument("-o", "--file", required=True, metavar="FILE", help="the file to write, such as crash.mcap")
    record.add_argument(
        "--since",
        metavar="DURATION",
        help='begin this long ago, such as "30s"; with --on, this long before its item; "oldest": with all held items; '
        "default: now",
    )
    record.add_argument("--for", dest="for_", metavar="DURATION", help="end after that time; default: at Ctrl-C")
    record.add_argument(
        "--on", metavar="CHANNEL", help="write a file for each item of this channel; FILE gets the item's seq"
    )
    record.add_argument("--compression", choices=("zstd", "lz4", "none"), default="zstd", help="default zstd")
    record.add_argument("--overwrite", action="store_true", help="overwrite an existing file")
    add_summary(record)


def run_record(arguments: argparse.Namespace) -> int:
    """Record, and print the summary."""
    if arguments.since != "oldest":
        duration_of("--since", arguments.since, least=0)  # raises for a wrong duration
    duration_of("--for", arguments.for_, least=0)
    if arguments.on is not None and arguments.for_ is None:
        raise InvalidArgument("--on needs --for, the time after which each file ends, as in --for 10s")
    with connected(arguments) as rt:
        if arguments.on is not None:
            return _EventRecordings(rt, arguments).run()
        recorder = _begin_recording(rt, arguments, Path(arguments.file), _begin_of(arguments.since, NOW))
        interruption.set_regular_end(lambda: recorder.hurry(STOP_DRAIN_S), STOP_S)
        with recorder:
            _print_start(recorder, arguments)
            with shown_progress(recording_progress(recorder, arguments.for_)):
                summary = recorder.wait()
    return _print_result(summary, arguments)


def _begin_recording(rt: Connection, arguments: argparse.Namespace, path: Path, begin: Bound | None) -> Recorder:
    return rt._record_from(
        begin,
        arguments.channels,
        path,
        for_=arguments.for_,
        compression=arguments.compression,
        overwrite=arguments.overwrite,
    )


def _begin_of(since: str | None, event: Bound) -> Bound | None:
    """Return the begin of a recording; None: now. `event`: the instant from which `--since` counts."""
    return None if since is None else OLDEST if since == "oldest" else event - since


def recording_progress(recorder: Recorder, for_: str | None) -> Callable[[], Progress]:
    """Return the function that reports the progress of a recording. `for_`: the recording's length, if it is known."""
    began_s = time.monotonic()
    length_s = None if for_ is None else parse_duration(for_, "--for") / 1e9

    def progress() -> Progress:
        passed_s = time.monotonic() - began_s
        share = passed_s / length_s if length_s else None
        return share, f"{recorder.recorded} items of {len(recorder.channels)} channels in {passed_s:.0f} s"

    return progress


def _print_start(recorder: Recorder, arguments: argparse.Namespace) -> None:
    names = recorder.channels
    shown = escaped(joined(names)) if len(names) <= 5 else f"{len(names)} channels"
    until = f"for {arguments.for_}" if arguments.for_ else "until Ctrl-C"
    print(f"stampede: recording {shown or 'no channel yet'} to {escaped(arguments.file)} {until}", file=sys.stderr)


def _print_result(summary: RecordingSummary | None, arguments: argparse.Namespace) -> int:
    assert summary is not None, "`wait` without a timeout returns the summary"
    print_summary(summary, arguments.output)
    return 0 if summary.complete else INCOMPLETE


def print_summary(summary: RecordingSummary, output_format: str, *, is_complete: bool | None = None) -> None:
    """Print the contents of a file, and the missing items.

    `is_complete`: whether the file has all items; None: as the summary says.
    """
    if output_format != "table":
        value = {
            "file": summary.path,
            "complete": summary.complete if is_complete is None else is_complete,
            "recorded": summary.recorded,
            "missing": summary.missing,
            "absent": list(summary.absent),
            "damaged": list(summary.damaged),
            "channels": [one.to_json() for one in summary.channels],
        }
        print_document(value, output_format)
        return
    rows = [_row(one) for one in summary.channels]
    print_rows(rows, "table", none=f"{escaped(summary.path)} has no channels")
    print_missing(summary)


def print_missing(summary: RecordingSummary) -> None:
    """Print the missing items of a file, a line for each gap."""
    for one in summary.channels:
        for gap in one.gaps[:GAPS_SHOWN]:
            print(f"missing: {gap_text(gap)}")
        if one.gap_count > GAPS_SHOWN:
            print(f"missing: {escaped(one.channel)}: {one.gap_count - GAPS_SHOWN} more gaps, which the file names")
    for text in (*summary.absent, *summary.damaged):
        print(f"missing: {escaped(text)}")


def _row(one: RecordedCounts) -> dict[str, Any]:
    length = None if one.start is None or one.end is None else format_duration(one.end - one.start)
    return {
        "channel": one.channel,
        "accepted": one.accepted,
        "recorded": one.recorded,
        "missing": one.missing if not one.gap_count or one.missing else "unknown",
        "bytes": bytes_text(one.payload_bytes),
        "begins": None if one.start is None else instant_text(one.start),
        "length": length,
    }


def gap_text(gap: RecordingGap) -> str:
    """Return a gap as a line for people."""
    items = "an unknown number of items" if gap.items is None else f"{gap.items} items"
    seqs = ""
    if gap.first_seq is not None:
        seqs = f", seq {gap.first_seq} to {'?' if gap.last_seq is None else gap.last_seq}"
    return escaped(f"{gap.channel}: {items}{seqs}: {gap.reason}: {gap.detail}")


class _EventRecordings:
    """Begins a recording for each item of a channel, at most PARALLEL_RECORDINGS_MAX at the same time."""

    def __init__(self, rt: Connection, arguments: argparse.Namespace) -> None:
        self._rt = rt
        self._arguments = arguments
        self._channel = existing_channel(rt, arguments.on)
        self._since = self._channel.stats().host_time  # after a loss of the host, events from this time on count
        self._events = self._channel.subscribe()
        self._paths: set[Path] = set()
        self._running: dict[Recorder, threading.Thread] = {}
        self._mutex = threading.Lock()
        self._stopping = False
        self._incomplete = False
        self._error: StampedeError | None = None

    def run(self) -> int:
        """Record until Ctrl-C. Returns the exit status. Finishes the files also if the events end with an error."""
        interruption.set_regular_end(self._stop, STOP_S)
        print(f"stampede: each item of {escaped(self._arguments.on)} begins a file, until Ctrl-C", file=sys.stderr)
        try:
            while self._follow():
                pass
        finally:
            for thread in list(self._running.values()):
                thread.join()
        if self._error is not None:
            raise self._error
        return INCOMPLETE if self._incomplete else 0

    def _follow(self) -> bool:
        """Begin a recording for each event until the subscription ends. Returns True if it has subscribed again."""
        with self._events as events:
            try:
                for item in events:
                    self._since = item.time + 1
                    self._begin(item)
            except IncarnationLost as error:
                self._note_missing(f"events may be missing: {error}")
        if events.dropped:
            self._note_missing(
                f"{events.dropped} events have no file: they left {self._arguments.on} before the command read them"
            )
        with self._mutex:
            continues = not self._stopping and self._error is None
            if continues:
                self._events = self._channel.subscribe(start=self._since)
            return continues

    def _note_missing(self, what: str) -> None:
        self._incomplete = True
        print(escaped(f"stampede: {what}"), file=sys.stderr)

    def _path_of(self, seq: int) -> Path:
        """The first free name for an event. The seqs of a new incarnation begin again at 1."""
        given = Path(self._arguments.file)
        stem, number = f"{given.stem}-{seq:06d}", 1
        path = given.with_name(f"{stem}{given.suffix}")
        while path in self._paths or (path.exists() and not self._arguments.overwrite):
            number += 1
            path = given.with_name(f"{stem}-{number}{given.suffix}")
        self._paths.add(path)
        return path

    def _begin(self, event: Item) -> None:
        seq, begin = event.seq, _begin_of(self._arguments.since, Bound(None, event.time))
        with self._mutex:
            if self._stopping:
                return
            if len(self._running) >= PARALLEL_RECORDINGS_MAX:
                self._note_missing(f"event #{seq} has no file: {PARALLEL_RECORDINGS_MAX} recordings are under way")
                return
            try:
                recorder = _begin_recording(self._rt, self._arguments, self._path_of(seq), begin)
            except StampedeError as error:
                self._note_missing(f"event #{seq} has no file: {error}")
                return
            thread = threading.Thread(target=self._record, args=(recorder,), daemon=True)
            self._running[recorder] = thread
        thread.start()

    def _record(self, recorder: Recorder) -> None:
        try:
            summary = recorder.wait()
            with self._mutex:
                self._incomplete |= _print_result(summary, self._arguments) == INCOMPLETE
                sys.stdout.flush()
        except StampedeError as error:
            self._error = self._error or error
            if isinstance(error, FileError):
                self._events.close()
        finally:
            with self._mutex:
                self._running.pop(recorder, None)

    def _stop(self) -> None:
        with self._mutex:
            self._stopping = True
            running = list(self._running)
        self._events.close()
        for recorder in running:
            recorder.hurry(STOP_DRAIN_S)
