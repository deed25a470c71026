"""`stampede lag`: how far channels, groups and queues are behind, the worst first."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, parse_count
from stampede_rt.cli.counter_readings import owners_of
from stampede_rt.cli.output import print_rows
from stampede_rt.errors import StampedeError
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Connection

ASKED_MAX = 200
"""The most groups, and the most queues, that one call asks for their state: each of them takes a call."""


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    text = "print how far channels, groups and queues are behind, the worst first"
    verb = add_verb(subparsers, "lag", text, run_lag)
    verb.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names, such as "cam/*"')
    verb.add_argument("--top", type=parse_count, default=20, metavar="N", help="print N lines at most; default 20")


def run_lag(arguments: argparse.Namespace) -> int:
    """Print the lags."""
    with connected(arguments) as rt:
        rows = [*_channels(rt, arguments.glob), *_groups(rt, arguments.glob), *_queues(rt, arguments.glob)]
    rows.sort(key=lambda row: (row["lag_nanos"] is not None, -(row["lag_nanos"] or 0), row["name"]))
    rows = rows[: arguments.top]
    if arguments.output == "table":
        rows = [_for_people(row) for row in rows]
    print_rows(rows, arguments.output, none=f"no channel, group or queue matches {arguments.glob!r}, or all are empty")
    return 0


def _row(kind: str, name: str, lag_nanos: int | None, waiting: int, held_back_by: str | None) -> dict[str, Any]:
    """One line of the output. `waiting`: the number of items or messages that wait, or the members that hold a group
    back."""
    return {"kind": kind, "name": name, "lag_nanos": lag_nanos, "waiting": waiting, "because": held_back_by}


def _for_people(row: dict[str, Any]) -> dict[str, Any]:
    lag = row["lag_nanos"]
    shown = None if lag is None else format_duration(round(lag, -6))
    return {
        "kind": row["kind"],
        "name": row["name"],
        "lag": shown,
        "waiting": row["waiting"],
        "because": row["because"],
    }


def _channels(rt: Connection, glob: str) -> Iterator[dict[str, Any]]:
    """The age of the newest item of each channel. `waiting`: the items that the slowest consumer has not consumed."""
    owners = owners_of(rt, glob)
    for host in rt.hosts():
        try:
            hosted = rt.hosted_channels(host.name, glob)
        except StampedeError as error:
            yield _row("host", host.name, None, 0, error.message)
            continue
        for name, stats in hosted.items():
            if stats.newest is not None and owners.get(name) == host.name:
                waiting = max((one.waiting for one in stats.consumers), default=0)
                yield _row("channel", name, stats.host_time - stats.newest, waiting, None)


def _groups(rt: Connection, glob: str) -> Iterator[dict[str, Any]]:
    """How far the cut of each group is behind. `waiting`: the members that hold it back."""
    for info in rt.groups(glob)[:ASKED_MAX]:
        try:
            status = rt.group(info.name).status()
        except StampedeError as error:
            yield _row("group", info.name, None, 0, error.message)
            continue
        names = ", ".join(channel.name for channel in status.waiting_on)
        lag = None if status.cut is None else status.host_time - status.cut
        because = names or (None if status.cut is not None else "it shows nothing yet")
        yield _row("group", info.name, lag, len(status.waiting_on), because)


def _queues(rt: Connection, glob: str) -> Iterator[dict[str, Any]]:
    """The age of the oldest message of each queue. `waiting`: the messages of the queue, leased ones included."""
    for info in rt.queues(glob)[:ASKED_MAX]:
        try:
            stats = rt.queue(info.name, create=False).stats()
        except StampedeError as error:
            yield _row("queue", info.name, None, 0, error.message)
            continue
        if stats.oldest is not None:
            takers = f"{stats.leased} leased, {stats.waiting_gets} takers wait"
            yield _row("queue", info.name, stats.host_time - stats.oldest, stats.held, takers)
