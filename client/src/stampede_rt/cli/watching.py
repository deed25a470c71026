"""`stampede watch`: channels, hosts and peers as they come and go."""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from collections.abc import Iterable
from queue import Queue
from typing import Any

from stampede_rt.cli.arguments import add_verb, connected, parse_count
from stampede_rt.cli.colours import Style, styled
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import policy_text
from stampede_rt.errors import StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.values.model import Change, ChannelInfo, HostInfo
from stampede_rt.values.peering import PeerChange

AHEAD_MAX = 1000  # changes that have come and are not printed yet; each is less than 64 KiB
COLOURS: dict[str, Style] = {"added": "green", "updated": "yellow", "removed": "red"}
SIGNS = {"added": "+", "updated": "~", "removed": "-"}


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    text = "print channels, hosts and peers as they come and go, until Ctrl-C"
    watch = add_verb(subparsers, "watch", text, run_watch)
    watch.add_argument("glob", nargs="?", default="*", metavar="GLOB", help='names of channels and peers: "cam/*"')
    watch.add_argument("--count", type=parse_count, metavar="N", help="stop after N changes")


def run_watch(arguments: argparse.Namespace) -> int:
    """Print changes of the directory. Hosts are all shown, because a channel goes with its host."""
    changes: Queue[Change | PeerChange | StampedeError] = Queue(AHEAD_MAX)
    with (
        connected(arguments) as rt,
        rt.watch(arguments.glob) as channels,
        rt.watch_peers(arguments.glob) as peers,
    ):
        alive = {host.host_id: host.alive for host in rt.hosts(include_dead=True)}
        for source in (channels, peers):
            threading.Thread(target=_pass_on, args=(source, changes), daemon=True).start()
        printed = 0
        while printed != arguments.count:
            change = changes.get()
            if isinstance(change, StampedeError):
                raise change
            if _is_told(change, alive):
                row = _row(change)
                print(_line(row) if arguments.output == "table" else json.dumps(row), flush=True)
                printed += 1
    return 0


def _pass_on(source: Iterable[Any], changes: Queue[Any]) -> None:
    """Put all changes of one watch, and the error that ends it, into the queue. Runs on a thread of its own."""
    try:
        for change in source:
            changes.put(change)
    except StampedeError as error:
        changes.put(error)


def _is_told(change: Change | PeerChange, alive: dict[bytes, bool]) -> bool:
    """Whether a change is one for people. A host notes its load every few seconds, which is not. Keeps `alive`."""
    if isinstance(change, PeerChange) or not isinstance(change.subject, HostInfo):
        return True
    host = change.subject
    before = alive.get(host.host_id)
    if change.kind == "removed":
        alive.pop(host.host_id, None)
    else:
        alive[host.host_id] = host.alive
    return change.kind == "removed" or before != host.alive


def _row(change: Change | PeerChange) -> dict[str, Any]:
    """Return a change for programs. `time` is the caller's clock, because the directory's log has no times to tell."""
    row: dict[str, Any] = {"time": time.time_ns(), "index": change.index, "change": change.kind}
    if isinstance(change, PeerChange):
        peer = change.peer
        return row | {"kind": "peer", "name": peer.name or peer.peer_id.hex(), "alive": peer.alive, "detail": peer.zone}
    thing = change.subject
    if isinstance(thing, ChannelInfo):
        detail = f"at {thing.host}, keeps {policy_text(thing.policy)}, epoch {thing.epoch}"
        return row | {"kind": "channel", "name": thing.name, "alive": thing.host_alive, "detail": detail}
    detail = f"at {thing.endpoints[0]}" if thing.endpoints else ""
    return row | {"kind": "host", "name": thing.name, "alive": thing.alive, "detail": detail}


def _line(row: dict[str, Any]) -> str:
    lost = "" if row["alive"] or row["change"] == "removed" else "  (lost)"
    told = f"{SIGNS[row['change']]} {row['kind']:<7} {escaped(row['name'])}{lost}  {escaped(row['detail'])}"
    return f"{instant_text(row['time'])}  {styled(told.rstrip(), COLOURS[row['change']], sys.stdout)}"
