"""The roles that may call each RPC. Pure.

The table has one row for each service of the contract, and one for each RPC that differs from its service. If a service
has no row, no role may call its methods. So the author of a new service must decide here which roles may call it.
"""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt_runtime.access.caller import ALL_ROLES, Caller, CallerKind
from stampede_rt_runtime.identity import Role

PACKAGE = "stampede_rt.v1"

_ALL = frozenset(Role)
_SUPERNODES = frozenset({Role.SUPERNODE})
_HOSTS = frozenset({Role.HOST})
# A host may live inside a client's process, and hosts call each other, so a host has all rights of a client.
_CALLERS = frozenset({Role.CLIENT, Role.OPERATOR, Role.HOST})
_OPERATORS = frozenset({Role.OPERATOR})

_CLUSTER_SERVICES = frozenset({Role.SUPERNODE, Role.HOST, Role.FRONTEND})

_SERVICES: Mapping[str, frozenset[Role]] = {
    "AccessService": _OPERATORS,
    "ChannelService": _CALLERS,
    "DirectoryService": _CALLERS,
    "FrontendService": _ALL,
    "GatekeeperService": _CALLERS,
    "GroupDirectoryService": _CALLERS,
    "GroupService": _CALLERS,
    "MembershipService": _OPERATORS | _SUPERNODES,
    "MigrationDirectoryService": _HOSTS,
    "MigrationService": _CALLERS,
    "PeerService": _CALLERS,
    "QueueDirectoryService": _CALLERS,
    "QueueService": _CALLERS,
    "QuotaService": _OPERATORS,
    "QuotaUseService": _OPERATORS,
    "RaftService": _SUPERNODES,
    "ReplicaDirectoryService": _CALLERS,
    "ReplicaService": _HOSTS,
}

_METHODS: Mapping[str, frozenset[Role]] = {
    "AccessService/GetAccessState": _CLUSTER_SERVICES,
    "DirectoryService/Ping": _ALL,
    "DirectoryService/ListSupernodes": _ALL,
    "DirectoryService/RegisterHost": _HOSTS,
    "DirectoryService/RenewHostLease": _HOSTS,
    "DirectoryService/DeregisterHost": _HOSTS,
    "GatekeeperService/Ping": _ALL,
    "GroupService/ExchangeTimes": _HOSTS,
    "MembershipService/CreateJoinToken": _OPERATORS,
    "MembershipService/TakeSnapshot": _OPERATORS,
    "MigrationService/DrainHost": _OPERATORS,
    "MigrationService/FeedQueue": _HOSTS,
    "MigrationService/HandOverQueue": _HOSTS,
    "MigrationService/MoveEachHere": _HOSTS,
    "ReplicaDirectoryService/SetReplicaInSync": _HOSTS,
    "ReplicaDirectoryService/ReportReplicaLoads": _HOSTS,
}

_FOREIGN: Mapping[str, frozenset[Role]] = {
    "/grpc.health.v1.Health/": _ALL,
    "/grpc.reflection.": _ALL,
}


def roles_for(method: str) -> frozenset[Role]:
    """The roles that may call `/package.Service/Method`; no roles if neither the method nor its service has a row."""
    service, _, name = method.removeprefix(f"/{PACKAGE}.").partition("/")
    if not method.startswith(f"/{PACKAGE}."):
        return next((roles for prefix, roles in _FOREIGN.items() if method.startswith(prefix)), frozenset())
    return _METHODS.get(f"{service}/{name}", _SERVICES.get(service, frozenset()))


def is_closed_to_clients(method: str) -> bool:
    """Whether only services of the cluster and operators may call the method, and clients may not.

    Such methods serve Raft, leases, links between hosts, membership, rules of access and quotas.
    """
    return bool(roles_for(method)) and Role.CLIENT not in roles_for(method)


def why_refused(method: str, caller: Caller) -> str:
    """The reason why `caller` may not call `method`, as one sentence; empty if it may."""
    allowed = roles_for(method)
    if caller.roles == ALL_ROLES or caller.roles & allowed:
        return ""
    who = " or ".join(sorted(allowed)) or "nobody"
    return f"{caller} may not call {method.rpartition('.')[2]}, which is for {who}; {_WAYS_OUT[caller.kind]}"


_WAYS_OUT: Mapping[CallerKind, str] = {
    CallerKind.CERTIFICATE: "use a certificate of that role",
    CallerKind.TOKEN: "use a token, a certificate or a secret of that role",
    CallerKind.CLIENT_SECRET: "use a token of that role, or the cluster's secret",
}
