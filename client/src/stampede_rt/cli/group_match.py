"""`stampede group match`, and functions that other verbs of groups use, too."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import checked, connected, parse_bound_text, parse_count, parse_time
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.item_text import item_line, item_row
from stampede_rt.errors import GroupNotFound
from stampede_rt.escaping import escaped
from stampede_rt.values.grouping import Matched

if TYPE_CHECKING:
    from stampede_rt import Channel, Connection, Group


def add_match_arguments(verb: argparse.ArgumentParser) -> None:
    """Add the arguments of `group match`."""
    verb.add_argument("--per", required=True, metavar="CHANNEL", help="the channel whose items each get a match")
    verb.add_argument(
        "--tolerance", required=True, metavar="DURATION", help='the greatest distance in time, such as "10ms"'
    )
    verb.add_argument("--unique", action="store_true", help="use each item in at most one match, the nearest")
    add_lateness(verb)
    verb.add_argument(
        "--from",
        dest="start",
        type=checked(parse_bound_text),
        metavar="TIME",
        help="begin with the items from this time on, for example oldest; default: only items that come from now on",
    )
    add_as_of(verb)
    verb.add_argument("-n", "--count", type=parse_count, metavar="N", help="stop after N matches")


def add_lateness(verb: argparse.ArgumentParser) -> None:
    """Add the option for items that come late."""
    verb.add_argument("--lateness", default="0s", metavar="DURATION", help="wait this long for late items; default 0s")


def add_as_of(verb: argparse.ArgumentParser) -> None:
    """Add the option for an earlier instant."""
    verb.add_argument(
        "--as-of",
        type=checked(parse_time),
        metavar="TIME",
        help="answer as the hosts would have answered at this time; for groups of recorded channels",
    )


def existing_group(rt: Connection, name: str) -> Group:
    """Open an existing group. Raises GroupNotFound with an error text for users of the command line."""
    try:
        return rt.group(name)
    except GroupNotFound as error:
        raise GroupNotFound(
            f"there is no group {name}; `stampede group ls` lists the groups, `stampede group create {name} "
            "CHANNEL ...` creates it"
        ) from error


def run_match(arguments: argparse.Namespace) -> int:
    """Print matches as they come."""
    with connected(arguments) as rt, _matches(existing_group(rt, arguments.group), arguments) as matches:
        for count, matched in enumerate(matches, 1):
            print(_match_text(matched) if arguments.output == "table" else json.dumps(_match_row(matched)), flush=True)
            if count == arguments.count:
                break
        if arguments.as_of is not None and matches.reason is not None:
            print(f"stampede: {matches.reason}: {escaped(matches.reason.detail)}", file=sys.stderr)
    return 0


def _matches(group: Group, arguments: argparse.Namespace) -> Any:
    return group.match(
        arguments.per,
        arguments.tolerance,
        unique=arguments.unique,
        lateness=arguments.lateness,
        partial=True,
        start=arguments.start,
        as_of=arguments.as_of,
    )


def _match_text(matched: Matched[Channel]) -> str:
    lines = [f"match {instant_text(matched.time)}"]
    lines += [f"  {channel.name}  {item_line(item)}" for channel, item in matched.items()]
    return "\n".join(lines + [f"  {channel.name}  nothing within the tolerance" for channel in matched.missing])


def _match_row(matched: Matched[Channel]) -> dict[str, Any]:
    return {
        "time": matched.time,
        "items": {channel.name: item_row(item) for channel, item in matched.items()},
        "missing": [channel.name for channel in matched.missing],
    }
