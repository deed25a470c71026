"""Reaches, lists and changes the supernodes of a running cluster, for an operator and for a joining supernode."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import grpc

from stampede_rt._sync.endpoints import EndpointPool
from stampede_rt.administration.in_force import EnforcingPart, parts_behind, ping_frontend, ping_host, ping_supernode
from stampede_rt.administration.quota_use import PartUse, uses_at
from stampede_rt.administration.removal import remove_member
from stampede_rt.cluster.connecting import parse_target
from stampede_rt.errors import (
    PermissionDenied,
    StampedeError,
    Unavailable,
    VersionMismatch,
    WrongCluster,
)
from stampede_rt.security.tls import TlsFiles
from stampede_rt.security.tls_diagnosis import explain_refusal
from stampede_rt.status import raise_from_rpc_error
from stampede_rt.transports.grpc_sync import ServerEndpoint
from stampede_rt.v1 import access_service_pb2 as access_pb
from stampede_rt.v1 import access_service_pb2_grpc, membership_service_pb2_grpc, quota_service_pb2_grpc
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import membership_service_pb2 as pb
from stampede_rt.v1.directory_pb2 import HostRecord, SupernodeRecord
from stampede_rt.version import PROTOCOL_VERSION, VERSION

CALL_SECONDS = 3.0  # for one call to one supernode or front-end
SNAPSHOT_SECONDS = 120.0  # for all parts of a snapshot
HOST_PAGES_MAX = 1000  # the pages of the list of hosts


class Cluster:
    """The supernodes of a running cluster.

    A call that names no supernode goes to the first of `addresses` that answers.

    `frontends`: the front-ends that named these addresses; empty if the operator named them.
    """

    def __init__(self, endpoints: EndpointPool, addresses: list[str], frontends: Sequence[str] = ()) -> None:
        self._endpoints = endpoints
        self._addresses = addresses
        self._frontends = frontends

    @property
    def cluster_id(self) -> str:
        """The id of the cluster, which every call names. Empty until a front-end or supernode has told the id."""
        return self._endpoints.metadata.cluster_id

    @property
    def is_secured(self) -> bool:
        """Whether the caller has a certificate."""
        return self._endpoints.credentials.tls is not None

    def members(self) -> directory_pb.ListSupernodesResponse:
        """Return the members, as the first supernode that answers knows them. Raises Unavailable."""
        with _explaining_another_service("no supernode", "a front-end with --url"):
            listed: directory_pb.ListSupernodesResponse = self._first(
                lambda endpoint: endpoint.call(endpoint.directory.ListSupernodes, _LIST, CALL_SECONDS)
            )
        return listed

    def ping(self, address: str) -> Any:
        """Return the answer of the supernode at `address` to Ping; None if the supernode does not answer."""
        return _ping(self._endpoints, address)

    def make_token(self, supernode_id: str, address: str, *, valid_nanos: int) -> pb.CreateJoinTokenResponse:
        """Make a token with which the supernode `supernode_id` can join at `address`. Raises StampedeError."""
        request = pb.CreateJoinTokenRequest(
            request_id=secrets.token_bytes(16), valid_nanos=valid_nanos, supernode_id=supernode_id, target=address
        )
        made: pb.CreateJoinTokenResponse = self._first(
            lambda endpoint: endpoint.call(_membership(endpoint).CreateJoinToken, request, CALL_SECONDS)
        )
        return made

    def issue_client_token(
        self, name: str, roles: Sequence[str], *, valid_nanos: int
    ) -> access_pb.CreateClientTokenResponse:
        """Make a token for a client named `name`. Raises the error with which the supernodes refuse the call."""
        request = access_pb.CreateClientTokenRequest(
            request_id=secrets.token_bytes(16), name=name, roles=roles, valid_nanos=valid_nanos
        )
        made: access_pb.CreateClientTokenResponse = self.ask_access("CreateClientToken", request)
        return made

    def revoke(self, serial: str) -> int:
        """Revoke a certificate or token, so that all services refuse it from then on.

        Returns the version of access that contains the revocation. Raises the error with which the supernodes refuse
        the call.
        """
        request = access_pb.RevokeCredentialRequest(request_id=secrets.token_bytes(16), serial=serial)
        return int(self.ask_access("RevokeCredential", request).version)

    def parts_behind(self, version: int, *, of_rules: bool = False) -> dict[str, str]:
        """Wait until all parts apply `version` of access (see `in_force.parts_behind`).

        Returns the parts that do not apply this version yet, each with the reason. With `of_rules` the list leaves
        out front-ends, because no rule concerns them. Raises PermissionDenied if the change revoked this caller's own
        credential.
        """
        try:
            judges = self._parts(with_frontends=not of_rules)
        except PermissionDenied as error:
            raise PermissionDenied(
                "this command used the revoked credential, and services refuse it now; so the command cannot "
                f"ask whether all services refuse it ({error.message})"
            ) from error
        except StampedeError as error:  # the change itself has succeeded
            return {"the cluster": error.message}
        return parts_behind(self._endpoints, judges, version)

    def quota_uses(self, subject_glob: str) -> Iterator[PartUse]:
        """Ask each part how much the callers that match `subject_glob` use of their quotas. Raises Unavailable."""
        return uses_at(self._endpoints, self._parts(with_frontends=True), subject_glob)

    def _parts(self, *, with_frontends: bool) -> list[EnforcingPart]:
        """Return the supernodes, front-ends and live hosts, which judge callers. Raises StampedeError."""
        members = [one for one in self.members().supernodes if one.endpoint.target]
        hosts = list(self._live_hosts())
        return [
            *(EnforcingPart(f"supernode {one.supernode_id}", one.endpoint.target, ping_supernode) for one in members),
            *(EnforcingPart(f"front-end {one}", one, ping_frontend) for one in self._frontends if with_frontends),
            *(EnforcingPart(f"host {one.name}", one.gatekeepers[0].target, ping_host) for one in hosts),
        ]

    def _live_hosts(self) -> Iterator[HostRecord]:
        request = directory_pb.ListHostsRequest()
        for _ in range(HOST_PAGES_MAX):
            page = self._first(lambda endpoint: endpoint.call(endpoint.directory.ListHosts, request, CALL_SECONDS))
            yield from (one for one in page.hosts if one.alive and one.gatekeepers)
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def revoked_serials(self) -> Sequence[str]:
        """Return the serial numbers of all revoked certificates and tokens."""
        listed = self.ask_access("ListRevokedCredentials", access_pb.ListRevokedCredentialsRequest())
        return tuple(listed.serials)

    def ask_access(self, rpc: str, request: Any) -> Any:
        """Call AccessService at the first supernode that answers. Raises the error with which it refuses the call."""
        return self._ask_newer(_access, rpc, request, "rules of access and client tokens")

    def ask_quotas(self, rpc: str, request: Any) -> Any:
        """Call QuotaService at the first supernode that answers. Raises the error with which it refuses the call."""
        return self._ask_newer(_quotas, rpc, request, "quotas")

    def _ask_newer(self, stub: Callable[[ServerEndpoint], Any], rpc: str, request: Any, what: str) -> Any:
        """Make a call that supernodes of earlier releases do not serve. `what` names the subject of the call in errors.

        Raises VersionMismatch if no supernode that answers serves the call.
        """
        try:
            return self._first(lambda endpoint: endpoint.call(getattr(stub(endpoint), rpc), request, CALL_SECONDS))
        except StampedeError as error:
            if not _is_unknown(error):
                raise
            raise VersionMismatch(
                f"no supernode that answers has {what}: all are of an earlier release; upgrade them (runbook: upgrade)"
            ) from error

    def remove(self, supernode_id: str) -> pb.RemoveSupernodeResponse:
        """Ask the leader to remove a member. Raises the leader's error, or Unavailable if there is no leader.

        If the outcome is unknown, the error says so, with the reason AMBIGUOUS.
        """
        request, known = pb.RemoveSupernodeRequest(supernode_id=supernode_id), self.members().supernodes
        if supernode_id not in {one.supernode_id for one in known}:
            raise no_member(supernode_id, known)
        return remove_member(supernode_id, known, self._leader_first(known), partial(self._ask_to_remove, request))

    def _ask_to_remove(self, request: pb.RemoveSupernodeRequest, address: str) -> pb.RemoveSupernodeResponse:
        endpoint = self._endpoints.to(address)
        method = _membership(endpoint).RemoveSupernode
        removed: pb.RemoveSupernodeResponse = endpoint.call(method, request, CALL_SECONDS)
        return removed

    def _leader_first(self, known: Sequence[SupernodeRecord]) -> list[str]:
        """Return the addresses of the members that answer, the leader's address first."""
        there = [one for one in known if is_there(one, self.ping(one.endpoint.target))]
        return [one.endpoint.target for one in sorted(there, key=lambda one: not one.is_leader)]

    def snapshot(self, address: str, *, include_data: bool, stale_ok: bool) -> Iterator[pb.TakeSnapshotResponse]:
        """Yield the snapshot of the supernode at `address`, part by part. Raises StampedeError."""
        endpoint = self._endpoints.to(address)
        request = pb.TakeSnapshotRequest(include_data=include_data, stale_ok=stale_ok)
        responses = endpoint.call(_membership(endpoint).TakeSnapshot, request, SNAPSHOT_SECONDS)
        try:
            yield from responses
        except grpc.RpcError as error:
            raise_from_rpc_error(error, f"the supernode at {address}")

    def _first(self, ask: Callable[[ServerEndpoint], Any]) -> Any:
        return _first(self._endpoints, self._addresses, ask)


_LIST = directory_pb.ListSupernodesRequest()


def _first(endpoints: EndpointPool, addresses: Sequence[str], ask: Callable[[ServerEndpoint], Any]) -> Any:
    """Return the first answer of the supernodes at `addresses`.

    If no supernode answers, raises the error of the last one. If certificates are the cause, the error says so.
    """
    failure: StampedeError = Unavailable("no supernode is known; name one with --member, or a front-end with --url")
    for address in addresses:
        try:
            return ask(endpoints.to(address))
        except Unavailable as error:
            failure = explain_refusal(address, endpoints.credentials.tls, seconds=CALL_SECONDS) or error
        except StampedeError as error:
            failure = error
    raise failure


def _ping(endpoints: EndpointPool, address: str) -> Any:
    endpoint = endpoints.to(address)
    try:
        return endpoint.call(endpoint.directory.Ping, directory_pb.DirectoryServicePingRequest(), CALL_SECONDS)
    except StampedeError:
        return None


def is_there(record: SupernodeRecord, pong: Any) -> bool:
    """Whether `pong` comes from the member that `record` describes, and not from another supernode at its address."""
    return pong is not None and pong.supernode_id == record.supernode_id


def no_member(supernode_id: str, known: Sequence[SupernodeRecord]) -> StampedeError:
    """Return the error for an id that no member has."""
    names = ", ".join(one.supernode_id for one in known)
    return StampedeError(f"no supernode has the id {supernode_id}; the members are {names}")


@contextmanager
def reached(
    frontend: str | None, member: str | None, *, secret: str | None = None, tls: TlsFiles | None = None
) -> Iterator[Cluster]:
    """Yield the cluster whose front-ends are at `frontend`, or whose supernodes are at `member`. Raises StampedeError.

    If both are None, the front-ends come from `$STAMPEDE_URL`. If `secret` or `tls` is None, the calls carry the
    secret or the certificate that `connect` would use.
    """
    target = parse_target(
        member or frontend or os.environ.get("STAMPEDE_URL"), name=None, secret=secret, zone=None, tls=tls
    )
    endpoints = EndpointPool(target.credentials)
    try:
        if member:
            yield Cluster(endpoints, _same_cluster(endpoints, target.frontends))
        else:
            yield Cluster(endpoints, _bound(endpoints, target.frontends), target.frontends)
    finally:
        endpoints.close()


def _bound(endpoints: EndpointPool, frontends: Sequence[str]) -> list[str]:
    request = frontend_pb.BindRequest(protocol_version=PROTOCOL_VERSION, version=VERSION)
    with _explaining_another_service("no front-end", "a supernode with --member"):
        bound = _first(
            endpoints, frontends, lambda endpoint: endpoint.call(endpoint.frontend.Bind, request, CALL_SECONDS)
        )
    endpoints.metadata.cluster_id = bound.cluster_id
    return [one.endpoint.target for one in bound.supernodes]


def _same_cluster(endpoints: EndpointPool, members: Sequence[str]) -> list[str]:
    """Return the addresses of `members`. Raises WrongCluster if two of them are of different clusters."""
    known_by = ""
    for address in members:
        pong = _ping(endpoints, address)
        if pong is not None:
            own = endpoints.metadata.cluster_id
            if own and pong.cluster_id not in ("", own):
                raise WrongCluster(
                    f"the supernodes {known_by} and {address} are of different clusters, {own} and {pong.cluster_id}; "
                    "name supernodes of one cluster",
                    metadata={"cluster_id": pong.cluster_id},
                )
            endpoints.metadata.cluster_id = own or pong.cluster_id
            known_by = known_by or address
    return list(members)


def _quotas(endpoint: ServerEndpoint) -> Any:
    return endpoint.stub(quota_service_pb2_grpc.QuotaServiceStub)


@contextmanager
def _explaining_another_service(expected: str, way_out: str) -> Iterator[None]:
    """Replace the error of a server that does not know the call: this server is a service of another kind.

    The new error begins with `expected`, such as "no supernode", and tells the operator to name `way_out` instead.
    """
    try:
        yield
    except StampedeError as error:
        if not _is_unknown(error):
            raise
        raise StampedeError(f"{expected} answers there, but another service does; name {way_out}") from error


def _is_unknown(error: StampedeError) -> bool:
    """Whether `error` says that the supernode does not serve the call."""
    cause = error.__cause__
    return isinstance(cause, grpc.Call) and cause.code() is grpc.StatusCode.UNIMPLEMENTED


def _access(endpoint: ServerEndpoint) -> Any:
    return endpoint.stub(access_service_pb2_grpc.AccessServiceStub)


def _membership(endpoint: ServerEndpoint) -> Any:
    return endpoint.stub(membership_service_pb2_grpc.MembershipServiceStub)
