"""`stampede move`: gives a channel to another host, while it is in use."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from stampede_rt.cli.arguments import add_verb, connected
from stampede_rt.cli.output import print_facts
from stampede_rt.values.proxying import MoveInfo
from stampede_rt.values.timeline import format_duration


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    move = add_verb(subparsers, "move", "move a channel to another host, while it is in use", run_move)
    move.add_argument("channel", help="the channel's name")
    move.add_argument("host", metavar="HOST", help="the host that becomes the owner")


def run_move(arguments: argparse.Namespace) -> int:
    """Move a channel."""
    with connected(arguments) as rt:
        moved = rt.move(arguments.channel, arguments.host)
    print_facts(move_row(moved, arguments.output), arguments.output)
    return 0


def move_row(moved: MoveInfo, form: str) -> dict[str, Any]:
    """Return a move as facts to print, for people or for programs."""
    facts = asdict(moved)
    if form == "table":
        facts["puts waited"] = format_duration(facts.pop("blackout_nanos"))
    return facts
