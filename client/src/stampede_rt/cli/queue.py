"""`stampede queue ...`: queues by name."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import (
    add_verb,
    checked,
    connected,
    parse_attribute,
    parse_count,
    timeout_seconds,
)
from stampede_rt.cli.messages import (
    add_payload,
    add_pending,
    add_taking,
    counted,
    payload_of,
    print_pending,
    print_sent,
    take,
)
from stampede_rt.cli.output import bytes_text, print_done, print_facts, print_rows, replication_text
from stampede_rt.cli.replicas import queue_replicas
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.errors import InvalidArgument, QueueNotFound
from stampede_rt.values.queueing import LEASE_NANOS_DEFAULT, ON_FULL
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import Connection, Queue, QueueInfo, QueuePolicy

POLICY_OPTIONS = (
    "max_items", "max_bytes", "copies", "on_full", "lease", "max_deliveries", "dead_letter", "replicas", "ack",
    "min_replicas",
)  # fmt: skip


def add_verbs(subparsers: Any) -> None:
    """Add the noun of this module and its verbs."""
    text = "queues: first in, first out, each message to one taker"
    noun = subparsers.add_parser("queue", help=text, description=text)
    verbs = noun.add_subparsers(dest="queue_verb", metavar="VERB", required=True, parser_class=VerbParser)
    ls = add_verb(verbs, "ls", "list queues", run_ls)
    ls.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names, such as "work/*"')
    ls.add_argument("-l", "--long", action="store_true", help="also print counters, which the hosts give")
    info = add_verb(verbs, "info", "print a queue's policy and counters", run_info)
    info.add_argument("queue", help="the queue's name")
    put = add_verb(verbs, "put", "put one message; creates an absent queue", run_put)
    put.add_argument("queue", help="the queue's name")
    add_payload(put, message_id=True)
    put.add_argument(
        "--attribute",
        type=checked(parse_attribute),
        action="append",
        metavar="KEY=VALUE",
        help="an attribute of the message; may be repeated",
    )
    put.add_argument(
        "--timeout",
        type=timeout_seconds,
        default=1.0,
        metavar="DURATION",
        help="wait this long for room, e.g. 500ms; default 1s",
    )
    _add_policy(put)
    get = add_verb(verbs, "get", "take messages, print and acknowledge them", run_get)
    get.add_argument("queue", help="the queue's name")
    add_taking(get)
    pending = add_verb(verbs, "pending", "list the leased messages and their takers", run_pending)
    pending.add_argument("queue", help="the queue's name")
    add_pending(pending)
    configure = add_verb(verbs, "configure", "change a queue's policy, while it is in use", run_configure)
    configure.add_argument("queue", help="the queue's name")
    _add_policy(configure)
    delete = add_verb(verbs, "delete", "delete a queue with its messages", run_delete)
    delete.add_argument("queue", help="the queue's name")


def _add_policy(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--max-items", type=parse_count, metavar="N", help="hold at most N messages")
    parser.add_argument("--max-bytes", type=parse_count, metavar="N", help="hold at most N bytes")
    parser.add_argument("--copies", type=parse_count, metavar="K", help="each message goes to K distinct takers")
    parser.add_argument("--on-full", choices=ON_FULL, help="what the host does with a put into a full queue")
    parser.add_argument("--lease", metavar="DURATION", help='the time that a taker has to acknowledge, such as "30s"')
    parser.add_argument(
        "--max-deliveries", type=parse_count, metavar="N", help="a message leaves the queue after N deliveries"
    )
    parser.add_argument(
        "--dead-letter", metavar="QUEUE", help="the queue for messages that leave after --max-deliveries"
    )

    parser.add_argument("--replicas", type=int, metavar="N", help="copies that can take over if the host is lost")
    parser.add_argument("--ack", choices=("host", "replica"), help="when the host acknowledges a put")
    parser.add_argument(
        "--min-replicas",
        type=int,
        metavar="N",
        help="with --ack replica, the queue pauses while fewer than N replicas are in sync",
    )


def _policy_of(arguments: argparse.Namespace) -> dict[str, Any]:
    return {name: getattr(arguments, name) for name in POLICY_OPTIONS}


def _existing(rt: Connection, name: str) -> Queue:
    try:
        return rt.queue(name, create=False)
    except QueueNotFound as error:
        raise QueueNotFound(
            f"there is no queue {name}; `stampede queue ls` lists the queues, `stampede queue put {name}` creates it"
        ) from error


def run_ls(arguments: argparse.Namespace) -> int:
    """List queues from the directory."""
    with connected(arguments) as rt:
        found = rt.queues(arguments.glob)
        names = _names(rt) if any(info.policy.dead_letter_queue_id for info in found) else {}
        rows = [_row(rt, info, names, arguments) for info in found]
    print_rows(rows, arguments.output, none=f"no queue matches {arguments.glob!r}")
    return 0


def _names(rt: Connection) -> dict[bytes, str]:
    return {info.queue_id: info.name for info in rt.queues()}


def _row(rt: Connection, info: QueueInfo, names: Mapping[bytes, str], arguments: argparse.Namespace) -> dict[str, Any]:
    lost = arguments.output == "table" and not info.host_alive
    row: dict[str, Any] = {
        "queue": info.name,
        "host": f"{info.host} (lost)" if lost else info.host,
        "policy": policy_text(info.policy, names),
        "epoch": info.epoch,
    }
    if arguments.long:
        row["created_by"] = info.created_by or None
        stats = rt.queue(info.name, create=False).stats() if info.host_alive else None
        for name in ("held", "leased", "accepted", "consumed"):
            row[name] = getattr(stats, name) if stats else None
    return row


def policy_text(policy: QueuePolicy, names: Mapping[bytes, str]) -> str:
    """Return a queue's policy as a short text for people. `names` has the names of queues by their ids."""
    dead = policy.dead_letter_queue_id
    lease_nanos = LEASE_NANOS_DEFAULT if policy.lease_nanos is None else policy.lease_nanos
    parts = [
        f"{policy.max_items} items" if policy.max_items is not None else "",
        bytes_text(policy.max_bytes) if policy.max_bytes is not None else "",
        f"{policy.copies} copies" if policy.copies is not None else "",
        policy.on_full or "",
        f"lease {format_duration(lease_nanos)}",
        f"{policy.max_deliveries} deliveries" if policy.max_deliveries is not None else "",
        f"dead letters to {names.get(dead, dead.hex())}" if dead is not None else "",
        replication_text(policy.replicas, policy.ack, policy.min_replicas),
    ]
    return ", ".join(part for part in parts if part)


def run_info(arguments: argparse.Namespace) -> int:
    """Print a queue's policy and counters."""
    with connected(arguments) as rt:
        queue = _existing(rt, arguments.queue)
        stats, info = queue.stats(), queue.info
        names = _names(rt) if stats.policy.dead_letter_queue_id else {}
        replicas = queue_replicas(rt, stats, arguments.output)
    facts = {
        "queue": info.name,
        "host": info.host,
        "created_by": info.created_by or None,
        "epoch": info.epoch,
        "incarnation": f"{stats.incarnation:016x}",
        "policy": policy_text(stats.policy, names),
        "replicas": replicas,
    }
    print_facts(facts | counted(stats, arguments.output), arguments.output)
    return 0


def run_put(arguments: argparse.Namespace) -> int:
    """Put one message, and print its queue and seq."""
    payload = payload_of(arguments)
    with connected(arguments) as rt:
        queue = rt.queue(arguments.queue, **_policy_of(arguments))
        sent = queue.put(
            payload, arguments.timeout, attributes=dict(arguments.attribute or ()), message_id=arguments.message_id
        )
    print_sent({"queue": arguments.queue}, sent, arguments.output)
    return 0


def run_configure(arguments: argparse.Namespace) -> int:
    """Change the stated settings, and print the policy after the change."""
    stated = _policy_of(arguments)
    if all(value is None for value in stated.values()):
        raise InvalidArgument("state at least one setting, such as --lease 30s; see stampede queue configure --help")
    with connected(arguments) as rt:
        policy = _existing(rt, arguments.queue).configure(**stated)
        names = _names(rt) if policy.dead_letter_queue_id else {}
    print_facts({"queue": arguments.queue, "policy": policy_text(policy, names)}, arguments.output)
    return 0


def run_get(arguments: argparse.Namespace) -> int:
    """Take messages and print them."""
    with connected(arguments) as rt, _existing(rt, arguments.queue) as queue:
        return take(queue, arguments)


def run_pending(arguments: argparse.Namespace) -> int:
    """List the leased messages of a queue and their takers."""
    with connected(arguments) as rt:
        found = _existing(rt, arguments.queue).pending(arguments.count)
    print_pending(found, arguments.queue, arguments.output)
    return 0


def run_delete(arguments: argparse.Namespace) -> int:
    """Delete a queue."""
    with connected(arguments) as rt:
        _existing(rt, arguments.queue).delete()
    print_done({"queue": arguments.queue, "deleted": True}, f"{arguments.queue} is deleted", arguments.output)
    return 0
