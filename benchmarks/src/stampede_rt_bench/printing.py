"""Prints results: for people each table as soon as it is measured, for programs one JSON document at the end."""

from __future__ import annotations

import sys

from stampede_rt.administration.output_forms import json_text
from stampede_rt_bench.tables import Table


def print_progress(text: str) -> None:
    """Report the progress on standard error."""
    print(f"stampede bench: {text}", file=sys.stderr, flush=True)


def announce(title: str, form: str) -> None:
    """Report the start of a measurement: in the form "table" as the head of its table, otherwise on standard error."""
    if form == "table":
        print(f"\n{title}", flush=True)
    else:
        print_progress(title)


def show(table: Table, form: str, title: str | None = None) -> None:
    """Print a table below its title, in the form "table" only."""
    if form == "table":
        if title is not None:
            print(title, flush=True)
        table.print()


def finish(values: object, text: str, form: str) -> None:
    """Print the last line for people, or the whole result as one JSON document."""
    print(text if form == "table" else json_text(values, form), flush=True)
