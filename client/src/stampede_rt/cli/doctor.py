"""`stampede doctor`: is everything reachable, in quorum and on time, and what to do if not."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from stampede_rt._sync.ports import Ports
from stampede_rt.cli.arguments import add_verb
from stampede_rt.cli.output import print_rows
from stampede_rt.connecting import Target, parse_target
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.timeline import format_duration
from stampede_rt.tls_diagnosis import certificate_end_unix_s, explain_refusal
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.version import PROTOCOL_VERSION, VERSION

TIMEOUT_S = 5.0  # a front-end looks for a healthy supernode for 2 s before it answers
CLOCK_OFFSET_NANOS_MAX = 50_000_000
CERTIFICATE_S_MIN = 14 * 86400.0


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    add_verb(subparsers, "doctor", "look whether the cluster is well, and say what to fix", run_doctor)


@dataclass(frozen=True, slots=True)
class Finding:
    """One part that was looked at; `advice` is empty if it is well. Offsets are of its clock against this machine's."""

    part: str
    address: str
    state: str
    advice: str = ""
    round_trip_nanos: int | None = None
    clock_offset_nanos: int | None = None
    version: str = ""


def run_doctor(arguments: argparse.Namespace) -> int:
    """Look at every part; exit status 1 if something is to be fixed."""
    target = parse_target(arguments.url or os.environ.get("STAMPEDE_URL"), name=None, secret=None, zone=None)
    ports = Ports(target.credentials)
    try:
        findings = list(_examine(target, ports))
    finally:
        ports.close()
    print_rows([_row(finding, arguments.output) for finding in findings], arguments.output, none="nothing found")
    advice = [f"{finding.part} {finding.address}: {finding.advice}" for finding in findings if finding.advice]
    if arguments.output == "table":
        print("\n" + ("\n".join(advice) if advice else "Everything is well."))
    return 1 if advice else 0


def _row(finding: Finding, form: str) -> dict[str, Any]:
    people = form == "table"

    def duration(nanos: int | None) -> Any:
        return format_duration(nanos) if people and nanos is not None else nanos

    return {
        "part": finding.part,
        "address": finding.address,
        "state": finding.state,
        "round_trip": duration(finding.round_trip_nanos),
        "clock_offset": duration(finding.clock_offset_nanos),
        "version": finding.version or None,
    } | ({} if people else {"advice": finding.advice})


def _examine(target: Target, ports: Ports) -> Iterator[Finding]:
    supernodes: dict[str, str] = {}
    for address in target.frontends:
        request = frontend_pb.BindRequest(protocol_version=PROTOCOL_VERSION, version=VERSION)
        response, finding = _probe(ports, "front-end", address, "frontend", "Bind", request)
        yield finding
        if response is not None:
            supernodes |= {record.endpoint.target: record.supernode_id for record in response.supernodes}
    ready = 0
    for address in supernodes:
        ping = directory_pb.DirectoryServicePingRequest()
        response, finding = _probe(ports, "supernode", address, "directory", "Ping", ping)
        ready += response is not None and response.ready
        yield finding
    if supernodes:
        yield _quorum(ready, len(supernodes))
        yield from _hosts(ports, list(supernodes))


def _quorum(ready: int, members: int) -> Finding:
    state = f"{ready} of {members} serve"
    if ready > members // 2:
        return Finding("quorum", "-", state)
    needed = members // 2 + 1
    return Finding("quorum", "-", state, f"the directory cannot serve; start supernodes until {needed} serve")


def _hosts(ports: Ports, supernodes: list[str]) -> Iterator[Finding]:
    for supernode in supernodes:
        port = ports.to(supernode)
        request = directory_pb.ListHostsRequest(include_dead=True, stale_ok=True)
        try:
            hosts = port.call(port.directory.ListHosts, request, TIMEOUT_S).hosts
        except StampedeError:
            continue
        break
    else:
        return
    if not hosts:
        yield Finding("host", "-", "none", "no channel host has registered; start one with `stampede host`")
    for host in hosts:
        yield _host(ports, host)


def _host(ports: Ports, host: Any) -> Finding:
    address = host.gatekeepers[0].target if host.gatekeepers else "-"
    name = f"host {host.name}"
    if not host.alive:
        return Finding(name, address, "lost", "its lease has ended; start it again, or open its channels anew")
    response, finding = _probe(ports, name, address, "gatekeeper", "Ping", gatekeeper_pb.GatekeeperServicePingRequest())
    if response is not None and not response.lease_held:
        return Finding(name, address, "fenced", "it cannot renew its lease; look at its way to the supernodes")
    return finding


def _probe(ports: Ports, part: str, address: str, service: str, method: str, request: Any) -> tuple[Any, Finding]:
    """One call; its response (None if it failed), and what it says of the part."""
    port = ports.to(address)
    started, sent = time.monotonic_ns(), time.time_ns()
    try:
        response = port.call(getattr(getattr(port, service), method), request, TIMEOUT_S)
    except StampedeError as error:
        refused = explain_refusal(address, ports.credentials.tls) if isinstance(error, Unavailable) else None
        return None, Finding(part, address, "unreachable", (refused or error).message)
    round_trip = time.monotonic_ns() - started
    offset = response.time_unix_nano - (sent + round_trip // 2)
    finding = Finding(part, address, "ok", "", round_trip, offset, response.version)
    judged = _judged(finding, getattr(response, "ready", True))
    return response, judged if judged.advice else replace(judged, advice=_about_certificate(ports, address))


def _about_certificate(ports: Ports, address: str) -> str:
    """What to do about a certificate that ends soon; empty if there is time."""
    tls = ports.credentials.tls
    end_s = certificate_end_unix_s(address, tls) if tls else None
    if end_s is None or (left_s := end_s - time.time()) > CERTIFICATE_S_MIN:
        return ""
    return f"its certificate ends in {left_s / 86400:.1f} days; issue it anew (stampede certs issue)"


def _judged(finding: Finding, ready: bool) -> Finding:
    state, advice = finding.state, ""
    if not ready:
        state, advice = "no leader", "it knows no leader; are a majority of the supernodes running and connected?"
    elif abs(finding.clock_offset_nanos or 0) > CLOCK_OFFSET_NANOS_MAX + (finding.round_trip_nanos or 0):
        advice = f"its clock is {format_duration(finding.clock_offset_nanos or 0)} off; synchronise it (chrony, ntpd)"
    elif finding.version != VERSION:
        advice = f"it runs version {finding.version}, this client {VERSION}; upgrade the older one"
    return Finding(
        finding.part,
        finding.address,
        state,
        advice,
        finding.round_trip_nanos,
        finding.clock_offset_nanos,
        finding.version,
    )
