"""`stampede hz` and `stampede bw`: rates, computed from the host's counters. The host sends no payloads for this."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, existing, parse_count
from stampede_rt.cli.output import bytes_text
from stampede_rt.values.statistics import ChannelStats

if TYPE_CHECKING:
    from stampede_rt import Channel


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    for name, text, run in (
        ("hz", "print a channel's items per second", run_hz),
        ("bw", "print a channel's bytes per second, in and out", run_bw),
    ):
        verb = add_verb(subparsers, name, f"{text}, until Ctrl-C", run)
        verb.add_argument("channel", help="the channel's name")
        verb.add_argument(
            "--every", type=period_seconds, default=1.0, metavar="SECONDS", help="print a line this often; default 1"
        )
        verb.add_argument("--count", type=parse_count, metavar="N", help="stop after N lines")


def period_seconds(text: str) -> float:
    """A period of 0.05 to 3600 seconds. Raises ArgumentTypeError."""
    seconds = float(text)
    if not 0.05 <= seconds <= 3600:
        raise argparse.ArgumentTypeError(f"{text} is out of range; write 0.05 to 3600 seconds")
    return seconds


def _samples(channel: Channel, every_s: float, count: int | None) -> Iterator[tuple[ChannelStats, ChannelStats]]:
    """Yield pairs of counters: earlier counters, and the counters about `every_s` later. Each has the host's time."""
    before = channel.stats()
    made = 0
    while count is None or made < count:
        time.sleep(every_s)
        after = channel.stats()
        yield before, after
        before = after
        made += 1


def run_hz(arguments: argparse.Namespace) -> int:
    """Print items per second."""
    with connected(arguments) as rt:
        for before, after in _samples(existing(rt, arguments.channel), arguments.every, arguments.count):
            seconds = (after.host_time - before.host_time) / 1e9
            accepted = after.accepted - before.accepted
            rejected = sum(after.rejected.values()) - sum(before.rejected.values())
            if arguments.output == "table":
                refused = f", {rejected / seconds:.1f} refused/s" if rejected else ""
                print(f"{accepted / seconds:8.1f} items/s{refused}   held {after.held}", flush=True)
            else:
                row = {"items_per_second": accepted / seconds, "rejected_per_second": rejected / seconds}
                print(json.dumps(row | {"held": after.held}), flush=True)
    return 0


def run_bw(arguments: argparse.Namespace) -> int:
    """Print bytes per second."""
    with connected(arguments) as rt:
        for before, after in _samples(existing(rt, arguments.channel), arguments.every, arguments.count):
            seconds = (after.host_time - before.host_time) / 1e9
            bytes_in = (after.accepted_bytes - before.accepted_bytes) / seconds
            bytes_out = (after.delivered_bytes - before.delivered_bytes) / seconds
            if arguments.output == "table":
                print(f"in {bytes_text(bytes_in)}/s   out {bytes_text(bytes_out)}/s", flush=True)
            else:
                row = {"in_bytes_per_second": bytes_in, "out_bytes_per_second": bytes_out}
                print(json.dumps(row), flush=True)
    return 0
