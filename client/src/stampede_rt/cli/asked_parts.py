"""The parts of a cluster that `stampede doctor` asks for their states, each with its request."""

from __future__ import annotations

from typing import Any, NamedTuple

from stampede_rt.cli.observations import FRONTEND, HOST, SUPERNODE, Observation
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.version import PROTOCOL_VERSION, VERSION


class AskedPart(NamedTuple):
    """One part of the cluster, and the request that asks for its state."""

    kind: str
    name: str
    address: str
    service: str
    method: str
    request: Any


class PartAnswer(NamedTuple):
    """The response of one part, or None if the call failed, and the observation that follows from it."""

    response: Any
    seen: Observation


def frontend_part(address: str) -> AskedPart:
    """The front-end at `address`, asked for the supernodes."""
    request = frontend_pb.BindRequest(protocol_version=PROTOCOL_VERSION, version=VERSION)
    return AskedPart(FRONTEND, "", address, "frontend", "Bind", request)


def supernode_part(name: str, address: str) -> AskedPart:
    """The supernode `name` at `address`, asked for its state."""
    return AskedPart(SUPERNODE, name, address, "directory", "Ping", directory_pb.DirectoryServicePingRequest())


def host_part(host: Any) -> AskedPart:
    """The host of a `HostRecord`, asked for its state."""
    request = gatekeeper_pb.GatekeeperServicePingRequest()
    return AskedPart(HOST, host.name, gatekeeper_of(host), "gatekeeper", "Ping", request)


def gatekeeper_of(host: Any) -> str:
    """The address of a host's gatekeeper; "-" if its record has none."""
    return host.gatekeepers[0].target if host.gatekeepers else "-"
