"""`stampede file info|verify|recover|cut|merge`: they work on MCAP files, and need no cluster."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_summary, checked, parse_time
from stampede_rt.cli.exit_statuses import FAILED, INCOMPLETE
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import bytes_text, print_document, print_facts, print_rows
from stampede_rt.cli.record import print_missing, print_summary
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.errors import FileError, InvalidArgument
from stampede_rt.escaping import escaped
from stampede_rt.values.recording import RecordingSummary
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT

if TYPE_CHECKING:
    from stampede_rt.files.file_report import FileReport

DAMAGES_SHOWN = 20


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = "MCAP files: look at them, verify, recover, cut and merge them"
    noun = subparsers.add_parser("file", help=text, description=text)
    verbs = noun.add_subparsers(dest="file_verb", metavar="VERB", required=True, parser_class=VerbParser)
    info = _verb(verbs, "info", "print the contents of a file, by its index", run_info)
    info.add_argument("path", metavar="FILE", help="an MCAP file")
    verify = _verb(verbs, "verify", "read a whole file, check every checksum, and compare with its summary", run_verify)
    verify.add_argument("path", metavar="FILE", help="an MCAP file")
    recover = _verb(
        verbs, "recover", "copy the readable part of a torn or damaged file, and name the lost items", run_recover
    )
    recover.add_argument("path", metavar="FILE", help="an MCAP file")
    cut = _verb(verbs, "cut", "copy the items of an interval, or of some channels", run_cut)
    cut.add_argument("path", metavar="FILE", help="an MCAP file")
    cut.add_argument("--from", dest="start", type=checked(parse_time), metavar="TIME", help="the earliest time")
    cut.add_argument(
        "--to", dest="end", type=checked(parse_time), metavar="TIME", help="the end of the times, exclusive"
    )
    cut.add_argument(
        "--channel", action="append", metavar="GLOB", help="a name, or a glob such as 'rig/*'; may be repeated"
    )
    merge = _verb(verbs, "merge", "write the items of several files to one, each item once", run_merge)
    merge.add_argument("paths", nargs="+", metavar="FILE", help="the MCAP files, at most 64")
    for verb in (recover, cut, merge):
        verb.add_argument("-o", "--file", required=True, metavar="FILE", help="the file to write")
        verb.add_argument("--overwrite", action="store_true", help="overwrite an existing file")


def _verb(verbs: Any, name: str, text: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    add_summary(parser)
    return parser


def run_info(arguments: argparse.Namespace) -> int:
    """Print the index of a file."""
    from stampede_rt.files.reading import FileReader

    with FileReader(arguments.path) as reader:
        index, summary = reader.index, reader.summary()
        if index is None or index.statistics is None:
            raise FileError(
                f"the file {arguments.path!r} has no index: its writer did not finish it; `stampede file verify` "
                "reads it all, and `stampede file recover` writes a whole file"
            )
        counts = index.statistics.channel_message_counts
        topics = [
            {"topic": topic.name, "encoding": topic.encoding, "messages": counts.get(number, 0)}
            for number, topic in sorted(index.topics.items())
        ]
        facts = {
            "file": reader.path,
            "size": bytes_text(reader.size) if arguments.output == "table" else reader.size,
            "writer": reader.library,
            "messages": index.statistics.message_count,
            "chunks": index.statistics.chunk_count,
            "begins": index.statistics.message_start_time,
            "ends": index.statistics.message_end_time,
        }
    if arguments.output != "table":
        recording = None if summary is None else [one.to_json() for one in summary.channels]
        print_document(facts | {"topics": topics, "recording": recording}, arguments.output)
        return 0
    times = {name: instant_text(int(facts[name])) for name in ("begins", "ends")}
    print_facts(facts | times, "table")
    print()
    if summary is not None and summary.channels:
        print_summary(summary, "table")
        return 0
    print_rows(topics, "table", none="no topics")
    if summary is not None:
        print_missing(summary)
    return 0


def run_verify(arguments: argparse.Namespace) -> int:
    """Verify a file. The status is 1 if it is damaged, and 3 if it names items that are missing."""
    from stampede_rt.files.editing import verify

    report = verify(arguments.path)
    _print_report(report, arguments.output, is_complete=report.complete)
    if not report.intact:
        return FAILED
    return 0 if report.summary.complete else INCOMPLETE


def run_recover(arguments: argparse.Namespace) -> int:
    """Recover a file. The status is 3 if anything is lost."""
    from stampede_rt.files.editing import recover

    report = recover(arguments.path, arguments.file, overwrite=arguments.overwrite)
    _print_report(report, arguments.output, is_complete=report.summary.complete)
    return 0 if report.summary.complete else INCOMPLETE


def _print_report(report: FileReport, output_format: str, *, is_complete: bool) -> None:
    print_summary(report.summary, output_format, is_complete=is_complete)
    for damage in report.damages[:DAMAGES_SHOWN]:
        place = f"byte {damage.offset} to {damage.end}"
        print(f"stampede: damaged: {place}: {escaped(damage.detail)}", file=sys.stderr)
    if len(report.damages) > DAMAGES_SHOWN:
        print(f"stampede: damaged: {len(report.damages) - DAMAGES_SHOWN} more places", file=sys.stderr)
    if report.unknown:
        print(f"stampede: damaged: {report.unknown} messages of topics that the file does not name", file=sys.stderr)
    if not report.finished and not report.damages:
        print("stampede: damaged: the file has no index", file=sys.stderr)
    for text in report.contradictions:
        print(f"stampede: damaged: {escaped(text)}", file=sys.stderr)


def run_cut(arguments: argparse.Namespace) -> int:
    """Cut a file."""
    from stampede_rt.files.editing import cut
    from stampede_rt.files.names import matches_any

    start = MIN_INSTANT if arguments.start is None else arguments.start
    end = MAX_INSTANT if arguments.end is None else arguments.end
    if start >= end:
        raise InvalidArgument("--from must be before --to")
    summary = cut(
        arguments.path, arguments.file, start=start, end=end, chosen=matches_any(arguments.channel),
        overwrite=arguments.overwrite,
    )  # fmt: skip
    return _written(summary, arguments)


def run_merge(arguments: argparse.Namespace) -> int:
    """Merge files."""
    from stampede_rt.files.merging import merge

    def warn(text: str) -> None:
        print(f"stampede: {escaped(text)}", file=sys.stderr)

    return _written(merge(arguments.paths, arguments.file, overwrite=arguments.overwrite, warn=warn), arguments)


def _written(summary: RecordingSummary, arguments: argparse.Namespace) -> int:
    print_summary(summary, arguments.output)
    if not summary.channels:
        print(f"stampede: {escaped(os.fspath(arguments.file))} has no items", file=sys.stderr)
    return 0 if summary.complete else INCOMPLETE
