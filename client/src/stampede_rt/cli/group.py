"""`stampede group ...`: groups of channels."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import (
    add_verb,
    checked,
    connected,
    existing_channel,
    parse_bound_text,
    parse_count,
)
from stampede_rt.cli.exit_statuses import NOTHING
from stampede_rt.cli.group_match import add_as_of, add_lateness, add_match_arguments, existing_group, run_match
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.item_text import item_line, item_row
from stampede_rt.cli.output import print_done, print_rows
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.escaping import escaped
from stampede_rt.values.grouping import Cut, GroupInfo, GroupStatus
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Channel, Connection, Group


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = "groups: channels that are read up to one common time"
    noun = subparsers.add_parser("group", help=text, description=text)
    verbs = noun.add_subparsers(dest="group_verb", metavar="VERB", required=True, parser_class=VerbParser)
    ls = add_verb(verbs, "ls", "list groups", run_ls)
    ls.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names, such as "stereo/*"')
    for name, what, run, add_arguments in (
        ("create", "create a group of channels", run_create, _add_create_arguments),
        ("status", "print the cut, the members that hold it back, and each member's time", run_status, None),
        ("newest", "print the newest visible item of each channel", run_newest, add_as_of),
        ("watch", "print items as they become visible, until Ctrl-C", run_watch, _add_watch_arguments),
        ("delete", "delete a group; its channels stay", run_delete, None),
        ("get", "print the visible items of each channel in an interval", run_get, _add_get_arguments),
        ("match", "print items of the same time together, until Ctrl-C", run_match, add_match_arguments),
        ("add", "add a channel to a group", run_change, _add_change_arguments),
        ("remove", "remove a channel from a group", run_change, _add_change_arguments),
    ):
        verb = add_verb(verbs, name, what, run)
        verb.add_argument("group", help="the group's name")
        if add_arguments is not None:
            add_arguments(verb)


def _add_create_arguments(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("channels", nargs="+", metavar="CHANNEL", help="the name of a member")
    verb.add_argument(
        "--reference",
        default="oldest",
        metavar="CHANNEL",
        help="the channel whose cut becomes the cut of the group; default: the smallest cut of all members",
    )
    verb.add_argument(
        "--bound",
        choices=("start", "end"),
        default="start",
        help="a channel's cut: the start of its newest item (default), or its end",
    )
    verb.add_argument(
        "--idle-after", metavar="DURATION", help='do not wait for a member that is silent for this time, such as "2s"'
    )
    verb.add_argument(
        "--max-lead",
        default="5s",
        metavar="DURATION",
        help='with --bound end: the cut is at most this far after the start of the newest item; default "5s"',
    )


def _add_watch_arguments(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--max-wait", default="1s", metavar="DURATION", help="wait this long for members that lag; default 1s"
    )
    add_lateness(verb)
    verb.add_argument("-n", "--count", type=parse_count, metavar="N", help="stop after N cuts")


def _add_get_arguments(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "start",
        type=checked(parse_bound_text),
        help='a time, or now, newest or oldest, also with an offset, such as "newest-1s"',
    )
    verb.add_argument("end", type=checked(parse_bound_text), help="written in the same way as the start")
    add_as_of(verb)


def _add_change_arguments(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("channel", help="the channel's name")


def run_ls(arguments: argparse.Namespace) -> int:
    """List groups from the directory."""
    with connected(arguments) as rt:
        groups = rt.groups(arguments.glob)
        names = {info.channel_id: info.name for info in rt.channels()} if groups else {}
    rows = [_group_row(info, names, arguments.output) for info in groups]
    print_rows(rows, arguments.output, none=f"no group matches {arguments.glob!r}")
    return 0


def _group_row(info: GroupInfo, names: dict[bytes, str], output_format: str) -> dict[str, Any]:
    idle: int | str | None = info.idle_after_nanos
    if output_format == "table" and info.idle_after_nanos is not None:
        idle = format_duration(info.idle_after_nanos)
    return {
        "group": info.name,
        "channels": [names.get(one, "?") for one in info.channel_ids],
        "reference": names.get(info.reference_id, "?") if info.reference_id else "oldest",
        "bound": info.bound,
        "idle_after": idle,
        "created_by": info.created_by or None,
    }


def run_create(arguments: argparse.Namespace) -> int:
    """Create a group."""
    with connected(arguments) as rt:
        members = [existing_channel(rt, name) for name in arguments.channels]
        group = rt.group(
            arguments.group,
            members,
            reference=arguments.reference,
            bound=arguments.bound,
            idle_after=arguments.idle_after,
            max_lead=arguments.max_lead,
        )
    _print_members(group, arguments.output)
    return 0


def _print_members(group: Group, output_format: str) -> None:
    names = [channel.name for channel in group.channels]
    print_done({"group": group.name, "channels": names}, f"{group.name}: {', '.join(names)}", output_format)


def run_status(arguments: argparse.Namespace) -> int:
    """Print a group's cut and its members' status."""
    with connected(arguments) as rt:
        status = existing_group(rt, arguments.group).status()
    if arguments.output == "table":
        print(_status_line(status))
    rows = [_member_row(status, channel, arguments.output) for channel in status.members]
    print_rows(rows, arguments.output, none="the group has no member")
    return 0


def _status_line(status: GroupStatus[Channel]) -> str:
    waiting = ", ".join(channel.name for channel in status.waiting_on)
    if status.cut is None:
        return f"nothing is visible yet; waiting for {waiting or 'its members'}"
    ago = format_duration(status.host_time - status.cut)
    return f"cut at {instant_text(status.cut)}, {ago} ago; " + (
        f"{waiting} {'hold' if len(status.waiting_on) > 1 else 'holds'} it back"
        if waiting
        else "no member holds it back"
    )


def _member_row(status: GroupStatus[Channel], channel: Channel, output_format: str) -> dict[str, Any]:
    member = status.members[channel]
    for_people = output_format == "table"
    return {
        "channel": channel.name,
        "newest": instant_text(member.newest) if for_people and member.newest is not None else member.newest,
        "ahead": _lead(member.lead_nanos) if for_people else member.lead_nanos,
        "hidden": member.hidden,
        "holds_the_cut": _shown_flag(channel in status.waiting_on, for_people),
        "idle": _shown_flag(member.idle, for_people),
        "window_too_short": _shown_flag(member.window_too_short, for_people),
    }


def _lead(nanos: int | None) -> str | None:
    """Return a text that says how far a member's newest item is ahead of the cut; None if that is not known."""
    if nanos is None:
        return None
    return format_duration(nanos) if nanos else "at the cut"


def _shown_flag(fact: bool, for_people: bool) -> bool | str:
    return ("yes" if fact else "no") if for_people else fact


def run_newest(arguments: argparse.Namespace) -> int:
    """Print the newest visible item of each channel."""
    with connected(arguments) as rt:
        found = existing_group(rt, arguments.group).newest(as_of=arguments.as_of)
    items = {channel.name: ([] if item is None else [item]) for channel, item in found.items()}
    reasons = {channel.name: reason for channel, reason in found.reasons.items()}
    return _print_items(items, reasons, arguments.output)


def run_get(arguments: argparse.Namespace) -> int:
    """Print the visible items of each channel in an interval."""
    with connected(arguments) as rt:
        found = existing_group(rt, arguments.group).get(arguments.start, arguments.end, as_of=arguments.as_of)
    reasons = {channel.name: items.reason for channel, items in found.items() if items.reason is not None}
    return _print_items({channel.name: list(items) for channel, items in found.items()}, reasons, arguments.output)


def _print_items(items: dict[str, list[Item]], reasons: dict[str, Reason], output_format: str) -> int:
    """Print the visible items of each channel. If items are missing, print the reason on standard error."""
    if output_format == "table":
        for name, held in items.items():
            print("\n".join(f"{name}  {item_line(item)}" for item in held) or f"{name}  nothing visible")
    else:
        print(json.dumps({name: [item_row(one) for one in held] for name, held in items.items()}))
    for name, reason in reasons.items():
        print(f"stampede: {name}: {reason}: {escaped(reason.detail)}", file=sys.stderr)
    return 0 if any(items.values()) else NOTHING


def run_watch(arguments: argparse.Namespace) -> int:
    """Print cut events as they come."""
    with connected(arguments) as rt, _cuts(existing_group(rt, arguments.group), arguments) as cuts:
        for count, cut in enumerate(cuts, 1):
            print(_cut_text(cut) if arguments.output == "table" else json.dumps(_cut_row(cut)), flush=True)
            if count == arguments.count:
                break
    return 0


def _cuts(group: Group, arguments: argparse.Namespace) -> Any:
    return group.subscribe(arguments.max_wait, lateness=arguments.lateness)


def _cut_text(cut: Cut[Channel]) -> str:
    lacking = f"  without {', '.join(channel.name for channel in cut.incomplete)}" if cut.incomplete else ""
    lines = [f"cut {instant_text(cut.time)}{lacking}"]
    for channel in cut:
        lines += [f"  {channel.name}  {item_line(item)}" for item in cut[channel]]
        lines += [f"  {channel.name}  late  {item_line(item)}" for item in cut.late[channel]]
    return "\n".join(lines)


def _cut_row(cut: Cut[Channel]) -> dict[str, Any]:
    return {
        "cut": cut.time,
        "items": {channel.name: [item_row(item) for item in cut[channel]] for channel in cut},
        "late": {channel.name: [item_row(item) for item in cut.late[channel]] for channel in cut},
        "incomplete": [channel.name for channel in cut.incomplete],
    }


def run_change(arguments: argparse.Namespace) -> int:
    """Add a channel to a group, or remove one."""
    with connected(arguments) as rt:
        group, channel = _group_and_channel(rt, arguments)
        if arguments.group_verb == "add":
            group.add(channel)
        else:
            group.remove(channel)
        _print_members(group, arguments.output)
    return 0


def _group_and_channel(rt: Connection, arguments: argparse.Namespace) -> tuple[Group, Channel]:
    return existing_group(rt, arguments.group), existing_channel(rt, arguments.channel)


def run_delete(arguments: argparse.Namespace) -> int:
    """Delete a group."""
    with connected(arguments) as rt:
        existing_group(rt, arguments.group).delete()
    done = {"group": arguments.group, "deleted": True}
    print_done(done, f"{arguments.group} is deleted; its channels stay", arguments.output)
    return 0
