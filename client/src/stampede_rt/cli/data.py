"""`stampede get` and `stampede echo`: they print items of a channel."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import (
    add_verb,
    checked,
    connected,
    existing_channel,
    parse_bound_text,
    parse_count,
    parse_time,
    timeout_seconds,
)
from stampede_rt.cli.exit_statuses import NOTHING
from stampede_rt.cli.item_text import add_item_options, item_printer, item_row, print_dropped, print_losses
from stampede_rt.cli.terminal import check_raw_output
from stampede_rt.errors import InvalidArgument
from stampede_rt.escaping import escaped
from stampede_rt.values.answers import Items
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.timeline import MIN_INSTANT, NEWEST, OLDEST, last

if TYPE_CHECKING:
    from stampede_rt import Channel

# by option: the options that would have no effect with it
_WITHOUT_EFFECT = {"at": ("bounds", "match", "limit", "newest_first", "complete"), "before": ("bounds", "match")}


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    _add_get(subparsers)
    echo = add_verb(subparsers, "echo", "print items as they come, until Ctrl-C", run_echo)
    echo.add_argument("channel", help="the channel's name")
    echo.add_argument(
        "--from",
        dest="start",
        type=checked(parse_bound_text),
        metavar="TIME",
        help="begin with the held items from this time on",
    )
    echo.add_argument("--mode", choices=("all", "newest"), default="all", help="every item, or always the newest one")
    echo.add_argument("--count", type=parse_count, metavar="N", help="stop after N items")
    echo.add_argument(
        "--via",
        choices=("multicast",),
        help="take the items from UDP multicast if it reaches this machine",
    )
    add_item_options(echo)


def _add_get(subparsers: Any) -> None:
    get = add_verb(subparsers, "get", "print items by time; without times the newest one", run_get)
    get.add_argument("channel", help="the channel's name")
    get.add_argument(
        "interval",
        nargs="*",
        type=checked(parse_bound_text),
        metavar="TIME",
        help='start and end: a time, or now, newest or oldest, also with an offset, such as "newest-30ms"',
    )
    _add_which(get)
    get.add_argument(
        "--bounds",
        choices=("[]", "[)", "(]", "()"),
        metavar="BOUNDS",  # `argparse` would drop the brackets in a list of choices
        help='the bounds that belong to the interval: "[]" (default), "[)", "(]", "()"',
    )
    get.add_argument(
        "--match",
        choices=("span", "whole", "start"),
        help="items whose span shares an instant with the interval (default), is in it, or starts in it",
    )
    get.add_argument("--limit", type=parse_count, metavar="N", help="print at most N items")
    get.add_argument("--newest-first", action="store_true", help="print the latest first")
    get.add_argument(
        "--timeout",
        type=timeout_seconds,
        default=0.0,
        metavar="DURATION",
        help="wait this long for an item, e.g. 500ms; default 0s",
    )
    get.add_argument("--complete", action="store_true", help="wait until no more items can come into the interval")
    get.add_argument(
        "--as-of",
        type=checked(parse_time),
        metavar="TIME",
        help="answer as the host would have answered at this time; for recorded channels",
    )
    add_item_options(get)
    get.add_argument("--raw", action="store_true", help="write only the payloads, without separators")


def _add_which(get: argparse.ArgumentParser) -> None:
    which = get.add_mutually_exclusive_group()
    which.add_argument("--last", metavar="DURATION", help='the items of the last DURATION, such as "30s"')
    which.add_argument(
        "--at", type=checked(parse_bound_text), metavar="TIME", help="the items whose spans contain this time"
    )
    which.add_argument(
        "--before", type=checked(parse_bound_text), metavar="TIME", help="the newest item before this time"
    )
    which.add_argument("--all", action="store_true", help="all held items")


def run_get(arguments: argparse.Namespace) -> int:
    """Get items and print them, or say why there are none."""
    _check_options(arguments)
    with connected(arguments) as rt:
        items, reason = _get(existing_channel(rt, arguments.channel), arguments)
    if arguments.raw:
        for item in items:
            check_raw_output(item.payload or b"")
            sys.stdout.buffer.write(item.payload or b"")
        sys.stdout.flush()
    else:
        _print_items(items, arguments)
    if reason is not None:
        print(f"stampede: {reason}: {escaped(reason.detail)}", file=sys.stderr)
    return 0 if items else NOTHING


def _check_options(arguments: argparse.Namespace) -> None:
    """Raises InvalidArgument for options that would have no effect together."""
    which = next((one for one in _WITHOUT_EFFECT if getattr(arguments, one) is not None), "")
    if arguments.interval and (which or arguments.last or arguments.all):
        raise InvalidArgument("give two times or one of --last, --at, --before, --all, not both")
    for one in _WITHOUT_EFFECT.get(which, ()):
        if getattr(arguments, one):
            raise InvalidArgument(f"--{one.replace('_', '-')} has no effect with --{which}; leave one of them out")


def _get(channel: Channel, arguments: argparse.Namespace) -> tuple[Sequence[Item], Reason | None]:
    payloads = not arguments.no_payloads
    if arguments.at is not None:
        items = channel.at(arguments.at, payloads=payloads, timeout=arguments.timeout, as_of=arguments.as_of)
        return items, items.reason
    items = _get_interval(channel, arguments, payloads)
    return items, items.reason


def _get_interval(channel: Channel, arguments: argparse.Namespace, payloads: bool) -> Items:
    start, end = _interval(arguments)
    newest_only = arguments.before is not None or not (arguments.interval or arguments.last or arguments.all)
    return channel.get(
        start,
        end,
        bounds="[)" if arguments.before is not None else arguments.bounds or "[]",
        match="start" if newest_only else arguments.match or "span",
        limit=(arguments.limit or 1) if newest_only else arguments.limit,
        newest_first=newest_only or arguments.newest_first,
        payloads=payloads,
        timeout=arguments.timeout,
        complete=arguments.complete,
        as_of=arguments.as_of,
    )


def _interval(arguments: argparse.Namespace) -> tuple[Any, Any]:
    if arguments.last:
        return last(arguments.last)
    if arguments.before is not None:
        return MIN_INSTANT, arguments.before
    if arguments.all:
        return OLDEST, NEWEST
    if len(arguments.interval) not in (0, 2):
        raise InvalidArgument("give two times, the start and the end, or none for the newest item")
    return tuple(arguments.interval) if arguments.interval else (NEWEST, NEWEST)


def _print_items(items: Sequence[Item], arguments: argparse.Namespace) -> None:
    if arguments.output == "json" and arguments.format is None:
        print(json.dumps([item_row(item) for item in items], indent=2))
        return
    line = item_printer(arguments)
    for item in items:
        print(line(item, arguments.channel if arguments.format else ""))


def run_echo(arguments: argparse.Namespace) -> int:
    """Print items as they come."""
    with (
        connected(arguments) as rt,
        existing_channel(rt, arguments.channel).subscribe(
            arguments.start, arguments.mode, payloads=not arguments.no_payloads, via=arguments.via
        ) as subscription,
    ):
        line = item_printer(arguments)
        for count, item in enumerate(subscription, 1):
            print(line(item, arguments.channel if arguments.format else ""), flush=True)
            if count == arguments.count:
                break
        print_dropped(subscription.dropped)
        print_losses(subscription.losses)
    return 0
