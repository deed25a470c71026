"""`stampede top`: the busiest channels, live. Needs `stampede-rt[top]` for the live view."""

from __future__ import annotations

import argparse
import json
import select
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, parse_count
from stampede_rt.cli.channel_rates import SORTS, ChannelRates, CounterReading, arranged, rates_of
from stampede_rt.cli.counter_readings import read_counters
from stampede_rt.cli.output import bytes_text
from stampede_rt.cli.rates import period_seconds
from stampede_rt.cli.top_columns import CHANNEL_MIN, COLUMN_NAMES, GAP, WIDTHS, fitting_columns
from stampede_rt.errors import InvalidArgument
from stampede_rt.escaping import escaped
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Connection

KEYS = "q quit   s sort   p pause   / filter   Esc clear the filter"
_ENTER, _ESCAPE, _ERASE = "\r\n", "\x1b", "\x7f\b"
LINES_BESIDE_ROWS = 5  # the title, the heads of the columns, the keys, and two lines in case one of these wraps


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    verb = add_verb(subparsers, "top", "show the busiest channels, live, until q or Ctrl-C", run_top)
    verb.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names, such as "cam/*"')
    verb.add_argument(
        "--sort", choices=SORTS, default="bytes", help="the column to sort by; default bytes (in plus out)"
    )
    verb.add_argument(
        "--every", type=period_seconds, default=1.0, metavar="SECONDS", help="refresh this often; default 1"
    )
    verb.add_argument("--count", type=parse_count, metavar="N", help="stop after N refreshes")


def run_top(arguments: argparse.Namespace) -> int:
    """Show the channels until the user quits. Without a terminal, print the rows of each refresh as JSON."""
    with connected(arguments) as rt:
        if arguments.output != "table" or not (sys.stdout.isatty() and sys.stdin.isatty()):
            _print_lines(rt, arguments)
        else:
            _show(rt, arguments)
    return 0


def _print_lines(rt: Connection, arguments: argparse.Namespace) -> None:
    before = read_counters(rt, arguments.glob)
    readings = 0
    while arguments.count is None or readings < arguments.count:
        time.sleep(arguments.every)
        after = read_counters(rt, arguments.glob)
        for row in arranged(rates_of(before, after), arguments.sort):
            print(json.dumps(asdict(row)))
        sys.stdout.flush()
        before, readings = after, readings + 1


class TopView:
    """The choices that the user has made by keys."""

    def __init__(self, sort: str) -> None:
        self.sort = sort
        self.is_paused = self.is_over = False
        self.filter = ""
        self.is_typing = False

    def press(self, key: str) -> None:
        """Take one key."""
        if self.is_typing and key not in _ENTER and key != _ESCAPE:
            self.filter = self.filter[:-1] if key in _ERASE else self.filter + (key if key.isprintable() else "")
        elif key in _ENTER:
            self.is_typing = False
        elif key == _ESCAPE:
            self.filter, self.is_typing = "", False
        elif key == "/":
            self.is_typing = True
        elif key == "q":
            self.is_over = True
        elif key == "p":
            self.is_paused = not self.is_paused
        elif key == "s":
            self.sort = SORTS[(SORTS.index(self.sort) + 1) % len(SORTS)]


def _show(rt: Connection, arguments: argparse.Namespace) -> None:
    try:
        from rich.console import Console
        from rich.live import Live
    except ImportError:
        raise InvalidArgument(
            "the live view needs rich: pip install 'stampede-rt[top]'; without it use stampede top --output jsonl"
        ) from None
    view, console = TopView(arguments.sort), Console(highlight=False)
    readings = [read_counters(rt, arguments.glob)] * 2
    with _keys() as read_key, Live(console=console, screen=True, auto_refresh=False) as live:

        def redraw() -> None:
            live.update(_table(readings[0], readings[1], view, console), refresh=True)

        refreshes = 0
        while not view.is_over and (arguments.count is None or refreshes < arguments.count):
            _wait(read_key, view, arguments.every, redraw)
            if not view.is_paused:
                readings[:] = readings[1], read_counters(rt, arguments.glob)
            refreshes += 1
            redraw()


def _wait(read_key: Callable[[float], str], view: TopView, seconds: float, redraw: Callable[[], None]) -> None:
    """Take keys until `seconds` have passed, or until the user quits."""
    end_s = time.monotonic() + seconds
    while not view.is_over and (left_s := end_s - time.monotonic()) > 0:
        for key in read_key(left_s):
            view.press(key)
            redraw()


@contextmanager
def _keys() -> Iterator[Callable[[float], str]]:
    """A function that waits for keys, for some seconds at most, and returns them. Keys are not shown meanwhile."""
    import os
    import termios
    import tty

    file = sys.stdin.fileno()
    former = termios.tcgetattr(file)

    def read(seconds: float) -> str:
        ready, _, _ = select.select([file], [], [], seconds)
        return os.read(file, 64).decode(errors="ignore") if ready else ""

    tty.setcbreak(file)
    try:
        yield read
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, former)


def _table(before: CounterReading, after: CounterReading, view: TopView, console: Any) -> Any:
    from rich.table import Table
    from rich.text import Text

    rows = arranged(rates_of(before, after), view.sort, view.filter)
    shown = rows[: max(1, console.size.height - LINES_BESIDE_ROWS)]
    state = f"sorted by {view.sort}{', paused' if view.is_paused else ''}"
    filtered = f"   filter: {view.filter}{'_' if view.is_typing else ''}" if view.filter or view.is_typing else ""
    table = Table(
        title=Text(f"{len(rows)} channels, {state}{escaped(filtered)}"),
        caption=Text(KEYS),
        expand=True,
        box=None,
        padding=(0, GAP, 0, 0),
        pad_edge=False,
    )
    _fill(table, shown, fitting_columns(console.size.width, max((len(row.channel) for row in rows), default=0)), Text)
    return table


def _fill(table: Any, rows: Sequence[ChannelRates], heads: Sequence[str], text: Callable[[str], Any]) -> None:
    table.add_column("CHANNEL", ratio=1, no_wrap=True, min_width=CHANNEL_MIN)
    for name in heads:
        table.add_column(name, justify="right", no_wrap=True, min_width=WIDTHS[name])
    for row in rows:
        cells = dict(zip(COLUMN_NAMES, _cells(row), strict=True))
        table.add_row(text(escaped(row.channel)), *(text(cells[name]) for name in heads))


def _cells(row: ChannelRates) -> tuple[str, ...]:
    age = "-" if row.age_nanos is None else format_duration(round(row.age_nanos, -6))
    return (
        escaped(row.host), f"{row.items:.1f}", bytes_text(row.bytes_in),
        bytes_text(row.bytes_out), age, str(row.lag_items) if row.lag_items else "-", str(row.held),
        str(row.subscriptions), _rate(row.refused), _rate(row.dropped),
    )  # fmt: skip


def _rate(count: float) -> str:
    return f"{count:.1f}" if count else "-"
