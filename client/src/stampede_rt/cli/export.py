"""`stampede export`: it writes channels or a file as MCAP, Parquet or CSV."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, checked, parse_time
from stampede_rt.cli.held_items import file_of
from stampede_rt.cli.output import print_rows
from stampede_rt.cli.record import GAPS_SHOWN, INCOMPLETE, gap_text, print_summary
from stampede_rt.errors import InvalidArgument
from stampede_rt.values.recording import RecordingSummary
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT

if TYPE_CHECKING:
    from stampede_rt.files.exporting import ExportSummary

FORMATS = ("mcap", "parquet", "csv")


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    export = add_verb(
        subparsers, "export", "write what channels hold, or a file, as MCAP, Parquet or CSV", run_export, output=False
    )
    export.add_argument("sources", nargs="+", metavar="SOURCE", help="channels or globs such as 'rig/*', or one file")
    export.add_argument(
        "-o", "--file", required=True, metavar="OUT", help="the file to write; the folder, for several tables"
    )
    export.add_argument("--format", choices=FORMATS, help="default: by the end of OUT's name")
    export.add_argument("--channel", action="append", metavar="GLOB", help="of a file: only these; may be repeated")
    export.add_argument("--from", dest="start", type=checked(parse_time), metavar="TIME", help="the first time")
    export.add_argument("--to", dest="end", type=checked(parse_time), metavar="TIME", help="the end, exclusive")
    export.add_argument("--overwrite", action="store_true", help="overwrite an existing file")
    export.add_argument("--summary", choices=("table", "json"), default="table", help="how to print the summary")


def run_export(arguments: argparse.Namespace) -> int:
    """Export. The status is 3 if anything is missing."""
    form = arguments.format or Path(arguments.file).suffix.removeprefix(".")
    if form not in FORMATS:
        raise InvalidArgument(f"{arguments.file} does not tell the format; give --format {', '.join(FORMATS)}")
    folder = Path(arguments.file).absolute().parent
    with file_of(arguments, arguments.sources, folder if folder.is_dir() else None) as (path, status):
        return max(status, _export_file(path, arguments, form))


def _export_file(path: str, arguments: argparse.Namespace, form: str) -> int:
    from stampede_rt.files.editing import cut
    from stampede_rt.files.exporting import export_tables
    from stampede_rt.files.foreign import source_of
    from stampede_rt.files.names import matches_any

    start = MIN_INSTANT if arguments.start is None else arguments.start
    end = MAX_INSTANT if arguments.end is None else arguments.end
    chosen = matches_any(arguments.channel)
    if form == "mcap":
        return _written(
            cut(path, arguments.file, start=start, end=end, chosen=chosen, overwrite=arguments.overwrite), arguments
        )
    source = source_of(path)
    try:
        tables = export_tables(
            source, arguments.file, form, chosen=chosen, start=start, end=end, overwrite=arguments.overwrite
        )
    finally:
        source.close()
    return _exported(tables, arguments)


def _written(summary: RecordingSummary, arguments: argparse.Namespace) -> int:
    print_summary(summary, arguments.summary)
    return 0 if summary.complete else INCOMPLETE


def _exported(summary: ExportSummary, arguments: argparse.Namespace) -> int:
    if arguments.summary == "json":
        print(json.dumps({"rows": dict(summary.rows), "gaps": [gap.to_json() for gap in summary.gaps]}, indent=2))
    else:
        print_rows([{"file": file, "rows": rows} for file, rows in summary.rows.items()], "table", none="no tables")
        for gap in summary.gaps[:GAPS_SHOWN]:
            print(f"missing: {gap_text(gap)}")
    return INCOMPLETE if summary.gaps else 0
