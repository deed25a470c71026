"""Waits a few seconds until the parts of a running cluster apply a change of access, such as a revocation."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from stampede_rt._sync.endpoints import EndpointPool
from stampede_rt.errors import StampedeError
from stampede_rt.transports.grpc_sync import ServerEndpoint
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.version import PROTOCOL_VERSION, VERSION

# How long `parts_behind` asks again; hosts and supernodes learn of changes immediately, front-ends within 1 s.
IN_FORCE_SECONDS = 5.0
CALL_SECONDS = 1.0  # the timeout of one call to one part
PAUSE_SECONDS = 0.02  # between two rounds; a round asks each part once


class EnforcingPart(NamedTuple):
    """A part of the cluster that decides what callers may do. `ask` makes a call to the part, and returns the answer.

    The answer has the version of access that the part applies. The version is the log position of the last change of
    rules, quotas, token keys or revocations.
    """

    name: str
    target: str
    ask: Callable[[ServerEndpoint], Any]


def parts_behind(endpoints: EndpointPool, judges: Iterable[EnforcingPart], version: int) -> dict[str, str]:
    """Wait until all `judges` apply `version` of access or a later one. Begins no round after IN_FORCE_SECONDS.

    A round asks one part after the other, so a part that hangs prolongs it by up to CALL_SECONDS. Returns the names of
    the parts that do not apply this version yet, each with the reason.
    """
    waiting, deadline_s = list(judges), time.monotonic() + IN_FORCE_SECONDS
    while True:  # ends when no part is behind, or when the time is over
        reasons = {one: _why_behind(endpoints, one, version) for one in waiting}
        waiting = [one for one in waiting if reasons[one]]
        if not waiting or time.monotonic() > deadline_s:
            return {one.name: reasons[one] for one in waiting}
        time.sleep(PAUSE_SECONDS)


def _why_behind(endpoints: EndpointPool, one: EnforcingPart, version: int) -> str:
    """Return why a part does not apply `version` yet; an empty text if the part applies it."""
    try:
        known = one.ask(endpoints.to(one.target)).access.version
    except StampedeError as error:
        return error.message
    return "" if known >= version else f"it still applies version {known} of access; {version} is in the directory"


def ping_supernode(endpoint: ServerEndpoint) -> Any:
    """Call Ping of a supernode."""
    return endpoint.call(endpoint.directory.Ping, directory_pb.DirectoryServicePingRequest(), CALL_SECONDS)


def ping_frontend(endpoint: ServerEndpoint) -> Any:
    """Call Bind of a front-end."""
    request = frontend_pb.BindRequest(protocol_version=PROTOCOL_VERSION, version=VERSION)
    return endpoint.call(endpoint.frontend.Bind, request, CALL_SECONDS)


def ping_host(endpoint: ServerEndpoint) -> Any:
    """Call Ping of a host."""
    return endpoint.call(endpoint.gatekeeper.Ping, gatekeeper_pb.GatekeeperServicePingRequest(), CALL_SECONDS)
