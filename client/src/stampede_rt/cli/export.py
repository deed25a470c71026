"""`stampede export`: it writes channels or a file as MCAP, Parquet or CSV."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_summary, add_verb, checked, parse_time
from stampede_rt.cli.exit_statuses import INCOMPLETE
from stampede_rt.cli.held_items import file_with_items_of
from stampede_rt.cli.output import print_document, print_rows
from stampede_rt.cli.progress import shown_progress
from stampede_rt.cli.record import GAPS_SHOWN, gap_text, print_summary
from stampede_rt.errors import InvalidArgument
from stampede_rt.escaping import escaped
from stampede_rt.values.recording import RecordingSummary
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT

if TYPE_CHECKING:
    from stampede_rt.files.exporting import ExportSummary

FORMATS = ("mcap", "parquet", "csv")


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    export = add_verb(
        subparsers, "export", "write items of channels, or of a file, as MCAP, Parquet or CSV", run_export, output=False
    )
    export.add_argument("sources", nargs="+", metavar="SOURCE", help="channels or globs such as 'rig/*', or one file")
    export.add_argument(
        "-o", "--file", required=True, metavar="OUT", help="the file to write, or the folder for several tables"
    )
    export.add_argument("--format", choices=FORMATS, help="default: the end of OUT's name decides")
    export.add_argument(
        "--channel", action="append", metavar="GLOB", help="only these topics of a file; may be repeated"
    )
    export.add_argument("--from", dest="start", type=checked(parse_time), metavar="TIME", help="the earliest time")
    export.add_argument(
        "--to", dest="end", type=checked(parse_time), metavar="TIME", help="the end of the times, exclusive"
    )
    export.add_argument("--overwrite", action="store_true", help="overwrite an existing file")
    add_summary(export)


def run_export(arguments: argparse.Namespace) -> int:
    """Export. The status is 3 if anything is missing."""
    file_format = arguments.format or Path(arguments.file).suffix.removeprefix(".")
    if file_format not in FORMATS:
        raise InvalidArgument(f"the name {arguments.file} does not show the format; give --format {', '.join(FORMATS)}")
    folder = Path(arguments.file).absolute().parent
    made_in = folder if folder.is_dir() else None
    with file_with_items_of(arguments, arguments.sources, made_in, needs_items=file_format != "mcap") as (path, status):
        began_s = time.monotonic()
        with shown_progress(lambda: (None, f"writing {escaped(arguments.file)}, {time.monotonic() - began_s:.0f} s")):
            exported = _export_file(path, arguments, file_format)
        return max(status, exported())


def _export_file(path: str, arguments: argparse.Namespace, file_format: str) -> Callable[[], int]:
    """Write the file. Returns the function that prints the summary and returns the status."""
    from stampede_rt.files.editing import cut
    from stampede_rt.files.exporting import export_tables
    from stampede_rt.files.foreign import source_of
    from stampede_rt.files.names import matches_any

    start = MIN_INSTANT if arguments.start is None else arguments.start
    end = MAX_INSTANT if arguments.end is None else arguments.end
    chosen = matches_any(arguments.channel)
    if file_format == "mcap":
        written = cut(path, arguments.file, start=start, end=end, chosen=chosen, overwrite=arguments.overwrite)
        return lambda: _written(written, arguments)
    source = source_of(path)
    try:
        tables = export_tables(
            source, arguments.file, file_format, chosen=chosen, start=start, end=end, overwrite=arguments.overwrite
        )
    finally:
        source.close()
    return lambda: _exported(tables, arguments)


def _written(summary: RecordingSummary, arguments: argparse.Namespace) -> int:
    print_summary(summary, arguments.output)
    return 0 if summary.complete else INCOMPLETE


def _exported(summary: ExportSummary, arguments: argparse.Namespace) -> int:
    if arguments.output != "table":
        gaps = [gap.to_json() for gap in summary.gaps]
        value = {"complete": summary.complete, "rows": dict(summary.rows), "gaps": gaps, "damaged": [*summary.damaged]}
        print_document(value, arguments.output)
    else:
        print_rows([{"file": file, "rows": rows} for file, rows in summary.rows.items()], "table", none="no tables")
        for gap in summary.gaps[:GAPS_SHOWN]:
            print(f"missing: {gap_text(gap)}")
        if len(summary.gaps) > GAPS_SHOWN:
            print(f"missing: {len(summary.gaps) - GAPS_SHOWN} more gaps")
        for text in summary.damaged:
            print(f"missing: {escaped(text)}")
    return 0 if summary.complete else INCOMPLETE
