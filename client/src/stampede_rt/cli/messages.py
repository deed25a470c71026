"""How the messages and counters of queues and mailboxes are printed, and what their verbs share."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any, Protocol

from stampede_rt.cli.arguments import parse_count
from stampede_rt.cli.output import attributes_text, bytes_text, payload_fields, preview
from stampede_rt.cli.terminal import check_raw_output
from stampede_rt.errors import InvalidArgument
from stampede_rt.timeline import format_duration, format_instant

if TYPE_CHECKING:
    from stampede_rt import Message, QueueStats

NOTHING = 3
STDIN_BYTES_MAX = 16 * 1024 * 1024


class Source(Protocol):
    """What messages are taken from."""

    def get(self, timeout: float | None = None) -> Message | None:
        """The next message."""


def add_payload(parser: argparse.ArgumentParser) -> None:
    """What is sent."""
    parser.add_argument("payload", nargs="?", help="the payload as text; without it, standard input is read")


def payload_of(arguments: argparse.Namespace) -> bytes:
    """What is to be sent. Raises InvalidArgument if standard input holds more than one item can."""
    if arguments.payload is not None:
        return str(arguments.payload).encode()
    payload = sys.stdin.buffer.read(STDIN_BYTES_MAX + 1)
    if len(payload) > STDIN_BYTES_MAX:
        raise InvalidArgument(f"standard input has more than {STDIN_BYTES_MAX} bytes, the most of one item; split it")
    return payload


def print_sent(thing: dict[str, Any], seq: int, form: str) -> None:
    """Say where an item went; `thing` is its kind and name."""
    (name,) = thing.values()
    print(f"{name} #{seq}" if form == "table" else json.dumps(thing | {"seq": seq}))


def take(source: Source, arguments: argparse.Namespace) -> int:
    """Take and print messages, each acknowledged once it is printed; the exit status."""
    for count in range(arguments.count):
        message = source.get(timeout=arguments.timeout)
        if message is None:
            if count == 0:
                within = f"came within {arguments.timeout:g} s" if arguments.timeout else "is there"
                print(f"stampede: nothing {within}", file=sys.stderr)
            return 0 if count else NOTHING
        with message:
            _print_message(message, arguments)
            if arguments.keep:
                message.nack()
    return 0


def _print_message(message: Message, arguments: argparse.Namespace) -> None:
    if arguments.raw:
        check_raw_output(message.payload)
        sys.stdout.buffer.write(message.payload)
        sys.stdout.flush()
    elif arguments.output == "table":
        again = f" (delivery {message.deliveries})" if message.deliveries > 1 else ""
        attributes = attributes_text(message.attributes)
        shown = preview(message.payload, len(message.payload), message.content_type)
        print(f"{format_instant(message.time)}  #{message.seq}{again}{attributes}  {shown}", flush=True)
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
    } | payload_fields(message.payload)


def counted(stats: QueueStats, form: str) -> dict[str, Any]:
    """A queue's counters as facts."""
    people = form == "table"
    age = None if stats.oldest is None else stats.host_time - stats.oldest
    return {
        "held": stats.held,
        "leased": stats.leased,
        "held_bytes": bytes_text(stats.held_bytes) if people else stats.held_bytes,
        "oldest_age": format_duration(age) if people and age is not None else age,
        "accepted": stats.accepted,
        "consumed": stats.consumed,
        "dropped": stats.dropped,
        "dead_lettered": stats.dead_lettered,
        "expelled": stats.expelled,
        "delivered": stats.delivered,
        "given_back": stats.given_back,
        "leases_expired": stats.leases_expired,
        "rejected": _rejected(stats) if people else dict(stats.rejected),
        "waiting_gets": stats.waiting_gets,
        "waiting_puts": stats.waiting_puts,
    }


def _rejected(stats: QueueStats) -> str:
    shown = [f"{count} {reason.replace('_', ' ')}" for reason, count in stats.rejected.items() if count]
    return ", ".join(shown) or "none"


def add_taking(parser: argparse.ArgumentParser) -> None:
    """How messages are taken."""
    parser.add_argument("-n", "--count", type=parse_count, default=1, metavar="N", help="so many; default 1")
    parser.add_argument(
        "--timeout", type=float, default=1.0, metavar="SECONDS", help="wait so long for each; default 1"
    )
    parser.add_argument("--keep", action="store_true", help="give them back instead of acknowledging them")
    parser.add_argument("--raw", action="store_true", help="write the payloads alone, one behind the other")
