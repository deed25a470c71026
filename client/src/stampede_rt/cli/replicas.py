"""`stampede replicas`: the replicas of a channel, which become the owner if the owner is lost."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, existing
from stampede_rt.cli.output import print_rows
from stampede_rt.values.statistics import ChannelStats
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Connection


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    text = "list the replicas of a channel, which become the owner if the owner is lost"
    verb = add_verb(subparsers, "replicas", text, run)
    verb.add_argument("channel", help="the channel's name")


def run(arguments: argparse.Namespace) -> int:
    """List the replicas of a channel."""
    with connected(arguments) as rt:
        rows = replica_rows(rt, existing(rt, arguments.channel).stats())
    if arguments.output == "table":
        rows = [_for_people(row) for row in rows]
    print_rows(rows, arguments.output, none=f"channel {arguments.channel} has no replicas")
    return 0


def replica_rows(rt: Connection, stats: ChannelStats) -> list[dict[str, Any]]:
    """Return the replicas of a channel that its owner feeds, those in sync first."""
    names = {one.host_id: one.name for one in rt.hosts()}
    rows = [
        {
            "host": names.get(one.host_id, one.host_id.hex()),
            "in_sync": one.in_sync,
            "waiting": one.waiting,
            "heard_ago_nanos": one.heard_ago_nanos,
        }
        for one in stats.copies
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
