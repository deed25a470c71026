"""Prints messages and counters, for the verbs of queues and mailboxes."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Protocol

from stampede_rt.cli.arguments import parse_count, timeout_seconds
from stampede_rt.cli.exit_statuses import NOTHING
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import attributes_text, bytes_text, payload_fields, print_done, print_rows
from stampede_rt.cli.payload_text import preview
from stampede_rt.cli.standard_input import PAYLOAD_BYTES_MAX, read_all
from stampede_rt.cli.terminal import check_raw_output
from stampede_rt.escaping import escaped
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import DeadLetterOrigin, Enqueued, Message, PendingMessage, QueueStats


class MessageSource(Protocol):
    """A handle that gives messages."""

    def get(self, timeout: float | None = None) -> Message | None:
        """Return the next message; None if no message comes within `timeout` seconds."""


def add_payload(parser: argparse.ArgumentParser, *, message_id: bool = False) -> None:
    """Add the payload argument, and for queues and mailboxes the message id."""
    parser.add_argument("payload", nargs="?", help="the payload as text; default: standard input")
    if message_id:
        text = "the id of the message; for 10 minutes the queue stores no second message with the same id"
        parser.add_argument("--message-id", metavar="ID", help=text)


def add_pending(parser: argparse.ArgumentParser) -> None:
    """Add the option for the number of messages to list."""
    parser.add_argument(
        "-n", "--count", type=parse_count, default=1000, metavar="N", help="list the N oldest; default 1000"
    )


def payload_of(arguments: argparse.Namespace) -> bytes:
    """Return the payload to send. Raises InvalidArgument if standard input is too long for one message."""
    if arguments.payload is not None:
        return os.fsencode(arguments.payload)  # exactly the bytes of the command line, even if they are no UTF-8
    return read_all(
        PAYLOAD_BYTES_MAX,
        f"standard input has more than {PAYLOAD_BYTES_MAX} bytes, the greatest size of one item or message; split it",
    )


def print_sent(thing: dict[str, Any], enqueued: Enqueued, output_format: str) -> None:
    """Print the seq of an accepted message. `thing` has one entry: the kind and the name of the queue or mailbox."""
    (name,) = thing.values()
    known = " (the queue has this message id already)" if enqueued.duplicate else ""
    done = thing | {"seq": enqueued.seq, "duplicate": enqueued.duplicate}
    print_done(done, f"{name} #{enqueued.seq}{known}", output_format)


def take(source: MessageSource, arguments: argparse.Namespace) -> int:
    """Take up to `--count` messages. Prints each message and then settles it. Returns the exit status."""
    for count in range(arguments.count):
        message = source.get(timeout=arguments.timeout)
        if message is None:
            if count == 0:
                within = (
                    f"no message came within {arguments.timeout:g} s" if arguments.timeout else "there is no message"
                )
                print(f"stampede: {within}", file=sys.stderr)
            return 0 if count else NOTHING
        with message:
            _print_message(message, arguments)
            if arguments.keep:
                message.nack()
            elif arguments.term is not None:
                message.term(arguments.term)
    return 0


def _print_message(message: Message, arguments: argparse.Namespace) -> None:
    if arguments.raw:
        check_raw_output(message.payload)
        sys.stdout.buffer.write(message.payload)
        sys.stdout.flush()
    elif arguments.output == "table":
        delivery = f" (delivery {message.deliveries})" if message.deliveries > 1 else ""
        attributes = attributes_text(message.attributes)
        shown = preview(message.payload, len(message.payload), message.content_type)
        print(f"{instant_text(message.time)}  #{message.seq}{delivery}{attributes}  {shown}", flush=True)
        if message.origin is not None:
            print(f"    {_origin_text(message.origin)}", flush=True)
    else:
        print(json.dumps(_row(message)), flush=True)


def _row(message: Message) -> dict[str, Any]:
    return {
        "time": message.time,
        "seq": message.seq,
        "deliveries": message.deliveries,
        "length_bytes": len(message.payload),
        "content_type": message.content_type,
        "attributes": dict(message.attributes),
        "origin": None if message.origin is None else _origin_row(message.origin),
    } | payload_fields(message.payload)


def _origin_text(origin: DeadLetterOrigin) -> str:
    """Return the origin of a dead letter as one line for people."""
    ended = origin.ended.replace("_", " ") or "for an unknown reason"
    by = f" by {escaped(origin.taker)}" if origin.taker else ""
    why = f": {escaped(origin.reason)}" if origin.reason else ""
    return (
        f"left {origin.queue or 'a mailbox'} #{origin.seq}, put {instant_text(origin.enqueued)}, at delivery "
        f"{origin.deliveries}, {ended}{by}{why}"
    )


def _origin_row(origin: DeadLetterOrigin) -> dict[str, Any]:
    ids = {"queue_id": origin.queue_id.hex(), "incarnation": f"{origin.incarnation:016x}"}
    return asdict(origin) | ids | {"taker_id": f"{origin.taker_id:016x}"}


def print_pending(pending: Sequence[PendingMessage], name: str, output_format: str) -> None:
    """List leased messages and their takers."""
    for_people = output_format == "table"
    rows = [
        {
            "seq": one.seq,
            "taker": one.taker,
            "taker_id": f"{one.taker_id:016x}",
            "deliveries": one.deliveries,
            "leased": instant_text(one.leased) if for_people else one.leased,
            "expires": instant_text(one.expires) if for_people else one.expires,
        }
        for one in pending
    ]
    print_rows(rows, output_format, none=f"no message of {name} is leased")


def counted(stats: QueueStats, output_format: str) -> dict[str, Any]:
    """Return a queue's counters by their names, for a table with texts for people or for JSON."""
    for_people = output_format == "table"
    age = None if stats.oldest is None else stats.host_time - stats.oldest
    return {
        "held": stats.held,
        "leased": stats.leased,
        "held_bytes": bytes_text(stats.held_bytes) if for_people else stats.held_bytes,
        "oldest_age": format_duration(age) if for_people and age is not None else age,
        "accepted": stats.accepted,
        "consumed": stats.consumed,
        "dropped": stats.dropped,
        "dead_lettered": stats.dead_lettered,
        "expelled": stats.expelled,
        "delivered": stats.delivered,
        "given_back": stats.given_back,
        "leases_expired": stats.leases_expired,
        "terminated": stats.terminated,
        "duplicates": stats.duplicates,
        "rejected": _rejected(stats) if for_people else dict(stats.rejected),
        "waiting_gets": stats.waiting_gets,
        "waiting_puts": stats.waiting_puts,
    }


def _rejected(stats: QueueStats) -> str:
    shown = [f"{count} {reason.replace('_', ' ')}" for reason, count in stats.rejected.items() if count]
    return ", ".join(shown) or "none"


def add_taking(parser: argparse.ArgumentParser) -> None:
    """Add the options for taking messages."""
    parser.add_argument("-n", "--count", type=parse_count, default=1, metavar="N", help="take N messages; default 1")
    parser.add_argument(
        "--timeout",
        type=timeout_seconds,
        default=1.0,
        metavar="DURATION",
        help="wait this long for each message, e.g. 500ms; default 1s",
    )
    settled = parser.add_mutually_exclusive_group()
    settled.add_argument("--keep", action="store_true", help="give the messages back instead of acknowledging them")
    settled.add_argument(
        "--term", metavar="REASON", help="give the messages up: they go to the dead-letter queue, if there is one"
    )
    parser.add_argument("--raw", action="store_true", help="write only the payloads, without separators")
