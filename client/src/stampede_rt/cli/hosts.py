"""`stampede hosts`: the hosts, and how busy each of them is."""

from __future__ import annotations

import argparse
import time
from typing import Any

from stampede_rt.cli.arguments import add_verb, connected
from stampede_rt.cli.output import bytes_text, print_rows, roughly
from stampede_rt.values.model import HostInfo


def add_verbs(subparsers: Any) -> None:
    """Add the verb of this module."""
    add_verb(subparsers, "hosts", "list hosts, with their channels and loads", run_hosts)


def run_hosts(arguments: argparse.Namespace) -> int:
    """List the hosts of the directory, also hosts whose leases have ended."""
    with connected(arguments) as rt:
        hosts = rt.hosts(include_dead=True)
    for_people = arguments.output == "table"
    rows = [_for_people(host) if for_people else _for_programs(host) for host in hosts]
    print_rows(rows, arguments.output, none="no host has registered; start one with `stampede host`")
    return 0


def _for_people(host: HostInfo) -> dict[str, Any]:
    load = host.load if host.alive else None
    return {
        "host": host.name,
        "address": host.endpoints[0] if host.endpoints else None,
        "machine": _machine(host),
        "lease": _lease(host),
        "channels": host.channels,
        "load": None if load is None else core_text(load.busy_permille),
        "memory": None if load is None else memory_text(load.held_bytes, load.bytes_max),
        "archive": host.archive_place,
        "version": host.version or None,
    }


def _for_programs(host: HostInfo) -> dict[str, Any]:
    load = host.load if host.alive else None
    return {
        "host": host.name,
        "host_id": host.host_id.hex(),
        "addresses": list(host.endpoints),
        "machine": _machine(host),
        "alive": host.alive,
        "lease_ended": host.lease_ended,
        "channels": host.channels,
        "busy_permille": load and load.busy_permille,
        "held_bytes": load and load.held_bytes,
        "memory_bytes_max": load and load.bytes_max,
        "archive": host.archive_place,
        "version": host.version or None,
    }


def _machine(host: HostInfo) -> str | None:
    """Return the machine in the host's address, or "this machine" if the address is a Unix socket."""
    if not host.endpoints:
        return None
    target = host.endpoints[0]
    return "this machine" if target.startswith("unix:") else target.rpartition(":")[0]


def _lease(host: HostInfo) -> str:
    if host.alive:
        return "held"
    if host.lease_ended is None:
        return "given up"
    return f"lost {roughly(max(0, time.time_ns() - host.lease_ended))} ago"


def core_text(busy_permille: int) -> str:
    """Return the share of a core as a text for people."""
    return f"{busy_permille / 10:.0f} % of a core"


def memory_text(held_bytes: int, bytes_max: int) -> str:
    """Return the held bytes and their limit as a text for people."""
    return f"{bytes_text(held_bytes)} of {bytes_text(bytes_max)}" if bytes_max else bytes_text(held_bytes)
