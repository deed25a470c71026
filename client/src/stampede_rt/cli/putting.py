"""`stampede put`: it puts one item, one for each line of standard input, or items at a rate."""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import repeat
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import (
    add_verb,
    checked,
    connected,
    parse_attribute,
    parse_count,
    parse_time,
    timeout_seconds,
)
from stampede_rt.cli.exit_statuses import FAILED
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.interrupts import interruption
from stampede_rt.cli.messages import add_payload, payload_of
from stampede_rt.cli.output import number_of, print_done
from stampede_rt.cli.policy_options import add_policy, policy_of
from stampede_rt.cli.standard_input import read_lines
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.values.payloads import check_attributes
from stampede_rt.values.timeline import parse_item_duration

if TYPE_CHECKING:
    from stampede_rt import Channel, Producer

STOP_S = 1.0  # after Ctrl-C the command waits at most this time for the host to acknowledge the last items
FLUSH_S = 30.0  # the wait for the last acknowledgements
RATE_MIN, RATE_MAX = 1e-5, 1e6  # items per second; the least one is about one a day


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    put = add_verb(subparsers, "put", "put items; creates an absent channel", run_put)
    put.add_argument("channel", help="the channel's name")
    add_payload(put)
    put.add_argument("--lines", action="store_true", help="put one item for each line of standard input")
    put.add_argument(
        "--rate", type=_rate, metavar="N", help="put N items per second: the payload again and again, or the lines"
    )
    put.add_argument("--count", type=parse_count, metavar="N", help="stop after N items; for --lines and --rate")
    put.add_argument(
        "--time", type=checked(parse_time), metavar="TIME", help="the item's time; default: the host's clock"
    )
    put.add_argument("--duration", metavar="DURATION", help='the duration of the item, such as "33ms"')
    put.add_argument(
        "--attribute",
        type=checked(parse_attribute),
        action="append",
        metavar="KEY=VALUE",
        help="an attribute of the item; may be repeated",
    )
    put.add_argument(
        "--timeout",
        type=timeout_seconds,
        default=1.0,
        metavar="DURATION",
        help="wait this long for room, e.g. 500ms; default 1s",
    )
    add_policy(put)


def _rate(text: str) -> float:
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not RATE_MIN <= rate <= RATE_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is not a rate; write the items per second, such as 10 or 0.5")
    return rate


def run_put(arguments: argparse.Namespace) -> int:
    """Put one item, and print its channel, seq and time. Or put many items, and print their number."""
    many = arguments.lines or arguments.rate is not None
    if arguments.lines and arguments.payload is not None:
        raise InvalidArgument("--lines reads the payloads from standard input; leave out the payload")
    if arguments.count is not None and not many:
        raise InvalidArgument("--count needs --rate or --lines")
    if arguments.time is not None and many:
        raise InvalidArgument("--time is for one item; with --rate or --lines each item has the time of its put")
    parse_item_duration(arguments.duration)  # before the channel is created
    check_attributes(dict(arguments.attribute or ()))
    payload = b"" if arguments.lines else payload_of(arguments)
    with connected(arguments) as rt:
        channel = rt.channel(arguments.channel, **policy_of(arguments))
        return _put_many(channel, payload, arguments) if many else _put_one(channel, payload, arguments)


def _put_one(channel: Channel, payload: bytes, arguments: argparse.Namespace) -> int:
    item = channel.put(
        payload,
        time=arguments.time,
        duration=arguments.duration,
        attributes=dict(arguments.attribute) if arguments.attribute else None,
        timeout=arguments.timeout,
    )
    done = {"channel": arguments.channel, "seq": item.seq, "time": item.time}
    text = f"{arguments.channel} #{item.seq} at {instant_text(item.time)} ({item.time})"
    print_done(done, text, arguments.output)
    return 0


def _put_many(channel: Channel, payload: bytes, arguments: argparse.Namespace) -> int:
    """Put until the input ends, the count is reached, or Ctrl-C. Return FAILED if the host has refused an item."""
    stopping = threading.Event()
    interruption.set_regular_end(stopping.set, STOP_S)
    with channel.producer() as producer, _reporting_cut_off(producer):
        _feed(producer, payload, arguments, stopping)
        refusal = _flushed(producer)
    refused = f", {producer.rejections} refused" if producer.rejections else ""
    done = {"channel": channel.name, "accepted": producer.accepted, "rejected": producer.rejections}
    print_done(done, f"{channel.name}: {number_of(producer.accepted, 'item')} put{refused}", arguments.output)
    if refusal is not None:
        print(f"stampede: the first refused item: {escaped(refusal.message)}", file=sys.stderr)
    return FAILED if producer.rejections else 0


@contextmanager
def _reporting_cut_off(producer: Producer) -> Iterator[None]:
    """If Ctrl-C ends the block before the last acknowledgement, say how many items the host has accepted."""
    try:
        yield
    except StampedeError:
        if interruption.requested:
            print(f"stampede: {producer.accepted} items put; later ones have no answer", file=sys.stderr, flush=True)
        raise


def _feed(producer: Producer, payload: bytes, arguments: argparse.Namespace, stopping: threading.Event) -> None:
    attributes = dict(arguments.attribute) if arguments.attribute else None
    began_s = time.monotonic()
    payloads = read_lines() if arguments.lines else repeat(payload)
    for number, one in enumerate(payloads):
        if arguments.rate is not None:
            stopping.wait(max(0.0, began_s + number / arguments.rate - time.monotonic()))
        if stopping.is_set():
            return
        producer.put(one, duration=arguments.duration, attributes=attributes, timeout=max(FLUSH_S, arguments.timeout))
        if number + 1 == arguments.count:
            return


def _flushed(producer: Producer) -> StampedeError | None:
    """Wait for all acknowledgements. Returns the first refusal, None without one. Raises other errors."""
    try:
        producer.flush(FLUSH_S)
    except StampedeError as error:
        if not producer.rejections:
            raise
        return error
    return None
