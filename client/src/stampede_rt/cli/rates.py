"""`stampede hz` and `stampede bw`: rates from the counters of the hosts, without any payloads."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, connected, existing_channel, is_glob, parse_count, timeout_seconds
from stampede_rt.cli.channel_rates import ChannelRates, CounterReading, arranged, jitter_of, rates_of
from stampede_rt.cli.counter_readings import read_counters
from stampede_rt.cli.output import bytes_text, print_rows, roughly
from stampede_rt.errors import StampedeError
from stampede_rt.values.statistics import ChannelStats
from stampede_rt.values.timeline import NEWEST

if TYPE_CHECKING:
    from stampede_rt import Channel, Connection

JITTER_ITEMS_MAX = 1000  # the jitter of a reading is measured on at most this many of the newest items
JITTER_ITEMS_MIN = 3  # a jitter needs two gaps between items


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    for name, text, run, help_ in (
        ("hz", "print items per second, jitter and lag of channels", run_hz, "a name, or a glob such as 'rig/*'"),
        ("bw", "print a channel's bytes per second, in and out", run_bw, "the channel's name"),
    ):
        verb = add_verb(subparsers, name, f"{text}, until Ctrl-C", run)
        verb.add_argument("channel", help=help_)
        verb.add_argument(
            "--every", type=period_seconds, default=1.0, metavar="SECONDS", help="take a reading this often; default 1"
        )
        verb.add_argument("--count", type=parse_count, metavar="N", help="stop after N readings")


def period_seconds(text: str) -> float:
    """A period of 0.05 to 3600 seconds. Raises ArgumentTypeError."""
    seconds = timeout_seconds(text)
    if not 0.05 <= seconds <= 3600:
        raise argparse.ArgumentTypeError(f"{text} is out of range; write 0.05 to 3600 seconds")
    return seconds


def _samples(channel: Channel, every_s: float, count: int | None) -> Iterator[tuple[ChannelStats, ChannelStats]]:
    """Yield the counters of one channel in pairs: earlier counters, and the counters about `every_s` later.

    `_readings` yields the counters of all channels that match a glob.
    """
    before = channel.stats()
    pairs = 0
    while count is None or pairs < count:
        time.sleep(every_s)
        after = channel.stats()
        yield before, after
        before = after
        pairs += 1


def run_hz(arguments: argparse.Namespace) -> int:
    """Print the rates of one channel in lines, or the rates of all channels that match a glob in tables."""
    name = arguments.channel
    with connected(arguments) as rt:
        if not is_glob(name):
            existing_channel(rt, name)
        for before, after in _readings(rt, name, arguments):
            rows = [_hz_row(rt, one, arguments) for one in arranged(rates_of(before, after), "name")]
            if not rows and not is_glob(name):
                existing_channel(rt, name).stats()  # raises the error: the channel or its host has gone
            if arguments.output != "table":
                sys.stdout.writelines(json.dumps(row) + "\n" for row in rows)
            elif not is_glob(name):
                sys.stdout.writelines(_hz_line(row) + "\n" for row in rows)
            else:
                print_rows([_hz_cells(row) for row in rows], "table", none=f"no channel matches {name!r}")
                print()
            sys.stdout.flush()
    return 0


def _readings(
    rt: Connection, glob: str, arguments: argparse.Namespace
) -> Iterator[tuple[CounterReading, CounterReading]]:
    """Yield pairs of readings of the hosts' counters, `--every` apart."""
    before = read_counters(rt, glob)
    pairs = 0
    while arguments.count is None or pairs < arguments.count:
        time.sleep(arguments.every)
        after = read_counters(rt, glob)
        yield before, after
        before, pairs = after, pairs + 1


def _hz_row(rt: Connection, rates: ChannelRates, arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "channel": rates.channel,
        "items_per_second": rates.items,
        "rejected_per_second": rates.refused,  # `refused` in tables
        "jitter_nanos": _jitter_nanos(rt, rates, arguments.every) if rates.items else None,
        "lag_nanos": rates.age_nanos,  # a channel lags by the age of its newest item
        "held": rates.held,
    }


def _jitter_nanos(rt: Connection, rates: ChannelRates, every_s: float) -> int | None:
    """Return the standard deviation of the times between the newest items. The host sends only their times."""
    try:
        items = rt.channel(rates.channel, create=False).get(
            # the time between two readings, or longer if the channel gets few items
            NEWEST - f"{max(every_s, JITTER_ITEMS_MIN / rates.items):f}s",
            NEWEST,
            match="start",
            limit=JITTER_ITEMS_MAX,
            newest_first=True,
            payloads=False,
        )
    except StampedeError:  # the channel is deleted, or the caller may read only its counters
        return None
    return jitter_of([item.time for item in items])


def _hz_line(row: dict[str, Any]) -> str:
    cells = _hz_cells(row)
    refused = f", {cells['refused/s']} refused/s" if row["rejected_per_second"] else ""
    measured = f"jitter {cells['jitter'] or '-'}   lag {cells['lag'] or '-'}   held {row['held']}"
    return f"{cells['items/s']:>8} items/s{refused}   {measured}"


def _hz_cells(row: dict[str, Any]) -> dict[str, Any]:
    jitter, lag = row["jitter_nanos"], row["lag_nanos"]
    return {
        "channel": row["channel"],
        "items/s": f"{row['items_per_second']:.1f}",
        "refused/s": f"{row['rejected_per_second']:.1f}" if row["rejected_per_second"] else None,
        "jitter": None if jitter is None else roughly(jitter),
        "lag": None if lag is None else roughly(lag),
        "held": row["held"],
    }


def run_bw(arguments: argparse.Namespace) -> int:
    """Print bytes per second."""
    with connected(arguments) as rt:
        for before, after in _samples(existing_channel(rt, arguments.channel), arguments.every, arguments.count):
            seconds = (after.host_time - before.host_time) / 1e9
            bytes_in = (after.accepted_bytes - before.accepted_bytes) / seconds
            bytes_out = (after.delivered_bytes - before.delivered_bytes) / seconds
            if arguments.output == "table":
                print(f"in {bytes_text(bytes_in)}/s   out {bytes_text(bytes_out)}/s", flush=True)
            else:
                row = {"channel": arguments.channel, "in_bytes_per_second": bytes_in, "out_bytes_per_second": bytes_out}
                print(json.dumps(row), flush=True)
    return 0
