"""`stampede replicas`: the replicas of a channel or queue, which become the owner if the owner is lost."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, existing_channel
from stampede_rt.cli.output import print_rows
from stampede_rt.values.proxying import CopyStats
from stampede_rt.values.queueing import QueueStats
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Connection


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    text = "list the replicas of a channel or queue, which become the owner if the owner is lost"
    verb = add_verb(subparsers, "replicas", text, run)
    verb.add_argument("channel", help="the channel's name, or with --queue the queue's name")
    verb.add_argument("--queue", action="store_true", help="list the replicas of a queue")


def run(arguments: argparse.Namespace) -> int:
    """List the replicas of a channel or queue."""
    name = arguments.channel
    with connected(arguments) as rt:
        copies = (
            rt.queue(name, create=False).stats().replicas
            if arguments.queue
            else existing_channel(rt, name).stats().copies
        )
        rows = replica_rows(rt, copies)
    if arguments.output == "table":
        rows = [_for_people(row) for row in rows]
    print_rows(rows, arguments.output, none=f"{'queue' if arguments.queue else 'channel'} {name} has no replicas")
    return 0


def replicas_text(wanted: int, rows: list[dict[str, Any]], *, behind: str = "items") -> str:
    """Return the rows of `replica_rows` as a text for people. `wanted`: the number of replicas in the policy."""
    shown = [
        f"{one['host']} ({'in sync' if one['in_sync'] else 'out of sync'}, {one['waiting']} {behind} behind)"
        for one in rows
    ]
    return f"{sum(one['in_sync'] for one in rows)} of {wanted} in sync" + (f": {', '.join(shown)}" if shown else "")


def queue_replicas(rt: Connection, stats: QueueStats, output_format: str) -> str | list[dict[str, Any]]:
    """Return the replicas of a queue, as a text for people or as rows for JSON."""
    rows, wanted = replica_rows(rt, stats.replicas), stats.policy.replicas
    if output_format != "table":
        return rows
    return replicas_text(wanted, rows, behind="changes") if wanted else "none"


def replica_rows(rt: Connection, copies: Sequence[CopyStats]) -> list[dict[str, Any]]:
    """Return the replicas among the copies that an owner feeds, those in sync first."""
    names = {one.host_id: one.name for one in rt.hosts()}
    rows = [
        {
            "host": names.get(one.host_id, one.host_id.hex()),
            "in_sync": one.in_sync,
            "waiting": one.waiting,
            "heard_ago_nanos": one.heard_ago_nanos,
        }
        for one in copies
        if one.replica
    ]
    return sorted(rows, key=lambda one: (not one["in_sync"], one["host"]))


def _for_people(row: dict[str, Any]) -> dict[str, Any]:
    return {
        "host": row["host"],
        "state": "in sync" if row["in_sync"] else "out of sync",
        "items_behind": row["waiting"],
        "heard": f"{format_duration(row['heard_ago_nanos'] // 10**6 * 10**6)} ago",
    }
