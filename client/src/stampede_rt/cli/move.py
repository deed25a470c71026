"""`stampede move` and `stampede rebalance`: give channels and queues to other hosts, while they are in use."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from stampede_rt.cli.arguments import add_verb, connected, existing_channel
from stampede_rt.cli.output import print_facts, print_rows
from stampede_rt.values.proxying import MoveInfo
from stampede_rt.values.timeline import format_duration


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    move = add_verb(subparsers, "move", "move a channel or queue to another host, while it is in use", run_move)
    move.add_argument("channel", help="the channel's name, or with --queue the queue's name")
    move.add_argument("--queue", action="store_true", help="move the queue of that name")
    move.add_argument("host", metavar="HOST", help="the host that becomes the owner")
    text = "show moves that would even out the loads of the hosts; with --apply perform them"
    rebalance = add_verb(subparsers, "rebalance", text, run_rebalance)
    rebalance.add_argument("--apply", action="store_true", help="perform the moves, one after the other")
    rebalance.add_argument(
        "--over", default="2s", metavar="DURATION", help="measure the work of the channels for this time; default: 2s"
    )


def run_move(arguments: argparse.Namespace) -> int:
    """Move a channel or queue."""
    with connected(arguments) as rt:
        if arguments.queue:
            moved = rt.move_queue(arguments.channel, arguments.host)
        else:
            moved = rt.move(existing_channel(rt, arguments.channel), arguments.host)
    print_facts(move_row(moved, "queue" if arguments.queue else "channel", arguments.output), arguments.output)
    return 0


def run_rebalance(arguments: argparse.Namespace) -> int:
    """Plan moves, and perform them if asked."""
    with connected(arguments) as rt:
        planned = rt.rebalance(apply=arguments.apply, over=arguments.over)
    none = "the loads of the hosts differ by less than a tenth of a core, or no move of a channel would help"
    print_rows([asdict(one) for one in planned], arguments.output, none=none)
    return 0


def move_row(moved: MoveInfo, subject: str, output_format: str) -> dict[str, Any]:
    """Return a move as facts to print, for people or for programs. `subject`: "channel" or "queue"."""
    facts = asdict(moved)
    facts = {subject: facts.pop("channel"), **facts}
    if output_format == "table":
        facts["puts waited"] = format_duration(facts.pop("blackout_nanos"))
    return facts
