"""`stampede watch`: channels, hosts and peers as they come and go."""

from __future__ import annotations

import argparse
import json
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from queue import Queue
from typing import TYPE_CHECKING, Any, NamedTuple

from stampede_rt.cli.arguments import add_verb, connected, parse_count
from stampede_rt.cli.colours import Style, styled
from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import policy_text
from stampede_rt.errors import WatchRestart
from stampede_rt.escaping import escaped
from stampede_rt.values.model import Change, ChannelInfo, HostInfo
from stampede_rt.values.peering import PeerChange, PeerInfo

if TYPE_CHECKING:
    from stampede_rt import Connection

Thing = ChannelInfo | HostInfo | PeerInfo
Facts = dict[str, Any]
Known = dict[bytes, Facts]
"""The latest known facts about each thing, by the id of the thing."""
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
    """Print changes of the directory. Shows all hosts, because a channel is lost if its host is lost."""
    rows: Queue[dict[str, Any] | Exception] = Queue(AHEAD_MAX)
    with connected(arguments) as rt:
        for source in (_CHANNELS_AND_HOSTS, _PEERS):
            threading.Thread(target=_follow, args=(rt, arguments.glob, source, rows), daemon=True).start()
        printed = 0
        while printed != arguments.count:
            row = rows.get()
            if isinstance(row, Exception):
                raise row
            print(_line(row) if arguments.output == "table" else json.dumps(row), flush=True)
            printed += 1
    return 0


class _Source(NamedTuple):
    """A watch of the directory, and the list of the things that it watches."""

    watch: Callable[[Connection, str], Any]
    listed: Callable[[Connection, str], Iterable[Thing]]


_CHANNELS_AND_HOSTS = _Source(
    lambda rt, glob: rt.watch(glob), lambda rt, glob: [*rt.channels(glob), *rt.hosts(include_dead=True)]
)
_PEERS = _Source(lambda rt, glob: rt.watch_peers(glob), lambda rt, glob: rt.peers(glob, include_dead=True))


def _follow(rt: Connection, glob: str, source: _Source, rows: Queue[Any]) -> None:
    """Put all changes, and the error that ends the watch, into the queue. Runs on a thread of its own.

    If supernodes no longer keep the changes since a break, this function begins a new watch, and puts the differences
    from the known things.
    """
    known: Known | None = None
    try:
        while True:
            with suppress(WatchRestart), source.watch(rt, glob) as changes:
                listed = {id_of(thing): facts_of(thing) for thing in source.listed(rt, glob)}
                for kind, facts in [] if known is None else differences(known, listed):
                    rows.put(_row(kind, None, facts))
                known = listed
                for change in changes:
                    _pass_on(change, known, rows)
    except Exception as error:  # noqa: BLE001  # the command raises it
        rows.put(error)


def _pass_on(change: Change | PeerChange, known: Known, rows: Queue[Any]) -> None:
    """Put one change into the queue, and note it in `known`.

    A host reports its load every few seconds. The command does not print these reports.
    """
    thing = change.peer if isinstance(change, PeerChange) else change.subject
    facts, former = facts_of(thing), known.get(id_of(thing))
    if change.kind == "removed":
        known.pop(id_of(thing), None)
    else:
        known[id_of(thing)] = facts
    if change.kind == "removed" or facts["kind"] != "host" or former is None or former["alive"] != facts["alive"]:
        rows.put(_row(change.kind, change.index, facts))


def differences(known: Known, listed: Known) -> list[tuple[str, Facts]]:
    """Return the changes that lead from `known` to `listed`: the kind of each, and the facts about the thing."""
    removed = [("removed", facts) for key, facts in known.items() if key not in listed]
    added = [("added", facts) for key, facts in listed.items() if key not in known]
    return removed + added + [("updated", facts) for key, facts in listed.items() if known.get(key, facts) != facts]


def id_of(thing: Thing) -> bytes:
    """Return the id of a thing. No two things have the same id, even if they are of different kinds."""
    if isinstance(thing, ChannelInfo):
        return thing.channel_id
    return thing.host_id if isinstance(thing, HostInfo) else thing.peer_id


def facts_of(thing: Thing) -> Facts:
    """Return the facts that a change reports about a thing."""
    if isinstance(thing, PeerInfo):
        name = thing.name or thing.peer_id.hex()
        return {"kind": "peer", "name": name, "alive": thing.alive, "detail": thing.zone}
    if isinstance(thing, ChannelInfo):
        detail = f"at {thing.host}, keeps {policy_text(thing.policy)}, epoch {thing.epoch}"
        return {"kind": "channel", "name": thing.name, "alive": thing.host_alive, "detail": detail}
    detail = f"at {thing.endpoints[0]}" if thing.endpoints else ""
    return {"kind": "host", "name": thing.name, "alive": thing.alive, "detail": detail}


def _row(kind: str, index: int | None, facts: Facts) -> dict[str, Any]:
    """Return a change for programs. `time` is the time of the caller's clock, because the directory does not report the
    times of changes."""
    return {"time": time.time_ns(), "index": index, "change": kind} | facts


def _line(row: dict[str, Any]) -> str:
    lost = "" if row["alive"] or row["change"] == "removed" else "  (lost)"
    text = f"{SIGNS[row['change']]} {row['kind']:<7} {escaped(row['name'])}{lost}  {escaped(row['detail'])}"
    return f"{instant_text(row['time'])}  {styled(text.rstrip(), COLOURS[row['change']], sys.stdout)}"
