"""`stampede mailbox ...` and `stampede peers`: peers, and the messages for them."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from stampede_rt.cli.arguments import add_verb, checked, connected, parse_attribute, timeout_seconds
from stampede_rt.cli.clock_findings import UNKNOWN, ahead, is_off
from stampede_rt.cli.instants import instant_text
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
from stampede_rt.cli.output import print_facts, print_rows
from stampede_rt.cli.replicas import queue_replicas
from stampede_rt.cli.verb_parser import VerbParser
from stampede_rt.errors import PeerNotFound
from stampede_rt.values.timeline import format_duration

if TYPE_CHECKING:
    from stampede_rt import PeerInfo


def add_verbs(subparsers: Any) -> None:
    """Add the noun `mailbox` and its verbs, and the verb `peers`."""
    peers = add_verb(subparsers, "peers", "list peers: connections with a name", run_peers)
    peers.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names, such as "robot/*"')
    peers.add_argument("--all", action="store_true", help="also list peers whose leases have ended")
    text = "messages to peers, by their names"
    noun = subparsers.add_parser("mailbox", help=text, description=text)
    verbs = noun.add_subparsers(dest="mailbox_verb", metavar="VERB", required=True, parser_class=VerbParser)
    send = add_verb(verbs, "send", "send one message to a peer", run_send)
    send.add_argument("peer", help="the peer's name")
    add_payload(send, message_id=True)
    send.add_argument(
        "--attribute",
        type=checked(parse_attribute),
        action="append",
        metavar="KEY=VALUE",
        help="an attribute of the message; may be repeated",
    )
    send.add_argument(
        "--timeout",
        type=timeout_seconds,
        default=1.0,
        metavar="DURATION",
        help="wait this long for room, e.g. 500ms; default 1s",
    )
    get = add_verb(verbs, "get", "register as the peer NAME, and take messages that others send to it", run_get)
    get.add_argument("name", metavar="NAME", help="the peer name; no live peer may have it")
    add_taking(get)
    pending = add_verb(verbs, "pending", "list the messages that a peer has taken and not settled", run_pending)
    pending.add_argument("peer", help="the peer's name")
    add_pending(pending)
    info = add_verb(verbs, "info", "print the counters of a peer's mailbox", run_info)
    info.add_argument("peer", help="the peer's name")


def run_peers(arguments: argparse.Namespace) -> int:
    """List peers from the directory."""
    with connected(arguments) as rt:
        peers = rt.peers(arguments.glob, include_dead=arguments.all)
        hosts = {host.host_id: host.name for host in rt.hosts()}
    rows = [_row(peer, hosts, arguments.output) for peer in peers]
    print_rows(rows, arguments.output, none=f"no peer matches {arguments.glob!r}")
    advice = _advice(peers)
    if advice and arguments.output == "table":
        print("\n" + "\n".join(advice))
    return 0


def _advice(peers: list[PeerInfo]) -> list[str]:
    """Return advice about wrong clocks of peers. `stampede doctor` applies the same rule."""
    return [
        f"{peer.name or peer.peer_id.hex()}: its clock is {ahead(peer.clock.offset_nanos)} that of supernode "
        f"{peer.clock.supernode}; synchronise it (chrony, ntpd), or ask `stampede doctor` which of the two is wrong"
        for peer in peers
        if peer.clock is not None and is_off(peer.clock.offset_nanos, peer.clock.uncertainty_nanos)
    ]


def _row(peer: PeerInfo, hosts: dict[bytes, str], output_format: str) -> dict[str, Any]:
    for_people = output_format == "table"
    return {
        "peer": peer.name or peer.peer_id.hex(),
        "alive": ("yes" if peer.alive else "no") if for_people else peer.alive,
        "since": instant_text(peer.registered) if for_people else peer.registered,
        "mailbox": ("yes" if peer.mailbox_queue_id else "no") if for_people else peer.mailbox_queue_id is not None,
        "host": hosts.get(peer.host_id) if peer.host_id is not None else None,
        "zone": peer.zone or None,
        "version": peer.version,
        "owner": peer.owner or None,
    } | _clock(peer, for_people)


def _clock(peer: PeerInfo, for_people: bool) -> dict[str, Any]:
    """Return the column for the offset of a peer's clock from a supernode's clock, mostly the leader's clock."""
    if not for_people:
        return {"clock": None if peer.clock is None else asdict(peer.clock)}
    if peer.clock is None:
        return {"clock_offset": UNKNOWN if peer.alive else None}
    offset, uncertainty = (format_duration(nanos) for nanos in (peer.clock.offset_nanos, peer.clock.uncertainty_nanos))
    return {"clock_offset": f"{offset} +/- {uncertainty}"}


def run_send(arguments: argparse.Namespace) -> int:
    """Send one message, and print its mailbox and seq."""
    payload = payload_of(arguments)
    with connected(arguments) as rt:
        try:
            sent = rt.send(
                arguments.peer,
                payload,
                arguments.timeout,
                attributes=dict(arguments.attribute or ()),
                message_id=arguments.message_id,
            )
        except PeerNotFound as error:
            raise _no_such_peer(arguments.peer) from error
    print_sent({"peer": arguments.peer}, sent, arguments.output)
    return 0


def run_get(arguments: argparse.Namespace) -> int:
    """Register under a name, take messages, and print them."""
    with connected(arguments, arguments.name) as rt:
        return take(rt.mailbox, arguments)


def run_pending(arguments: argparse.Namespace) -> int:
    """List the messages that a peer has taken from its mailbox and not yet settled."""
    with connected(arguments) as rt:
        try:
            found = rt.mailbox_pending(arguments.peer, arguments.count)
        except PeerNotFound as error:
            raise _no_such_peer(arguments.peer) from error
    print_pending(found, f"the mailbox of {arguments.peer}", arguments.output)
    return 0


def run_info(arguments: argparse.Namespace) -> int:
    """Print the counters of a mailbox."""
    with connected(arguments) as rt:
        try:
            stats = rt.mailbox_stats(arguments.peer)
            replicas = queue_replicas(rt, stats, arguments.output)
        except PeerNotFound as error:
            raise _no_such_peer(arguments.peer) from error
    facts: dict[str, Any] = {"peer": arguments.peer, "incarnation": f"{stats.incarnation:016x}"}
    facts["replicas"] = replicas
    print_facts(facts | counted(stats, arguments.output), arguments.output)
    return 0


def _no_such_peer(name: str) -> PeerNotFound:
    return PeerNotFound(f"no live peer is named {name}; `stampede peers` lists the live ones")
