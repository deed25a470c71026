"""Serves MembershipService (proto/stampede_rt/v1/membership_service.proto). Each method checks the request, asks the
log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable

from stampede_rt.errors import (
    InvalidArgument,
    Overloaded,
    PermissionDenied,
    Unavailable,
    VersionMismatch,
)
from stampede_rt.v1 import membership_service_pb2 as pb
from stampede_rt.v1 import membership_service_pb2_grpc
from stampede_rt_runtime.access.control import audit_change
from stampede_rt_runtime.admission import caller_identity
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_runtime.values import parse_target
from stampede_rt_supernode import replication
from stampede_rt_supernode.core.validation import check_id
from stampede_rt_supernode.joining.join_tokens import JoinTokens, valid_until
from stampede_rt_supernode.joining.members import Members, why_diverged
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication import Member, ReplicatedLog
from stampede_rt_supernode.replication.interface import too_old
from stampede_rt_supernode.servicers.lease_keeper import not_leader

PROTOCOL_VERSION = 1
# The longest time that a call waits for the newcomer and the other supernodes, even if the caller's deadline is later.
WAIT_SECONDS_MAX = 60.0
# This time is subtracted from the caller's deadline, so that the caller gets the reason and not only a deadline error.
ANSWER_SECONDS = 0.1
MEMBER_ID_CHARACTERS_MAX = 128
SNAPSHOTS_MAX = 4  # the most calls of TakeSnapshot at the same time
# How long TakeSnapshot waits for a majority. Members that reach each other answer soon, or elect a leader within 4 s.
QUORUM_SECONDS = 5.0


class MembershipServicer(membership_service_pb2_grpc.MembershipServiceServicer):
    """One supernode's answers about the members of the cluster. Only the leader changes the members."""

    def __init__(
        self,
        log: ReplicatedLog,
        replica: DirectoryReplica,
        members: Members,
        clock: HostClock,
        *,
        log_cluster_id: str,
    ) -> None:
        self._log = log
        self._replica = replica
        self._members = members
        self._clock = clock
        self._log_cluster_id = log_cluster_id
        self._snapshots_under_way = 0

    @errors_as_status
    async def CreateJoinToken(self, request: pb.CreateJoinTokenRequest, context: Context) -> pb.CreateJoinTokenResponse:
        check_id(request.request_id, "request_id")
        valid_nanos = request.valid_nanos if request.HasField("valid_nanos") else None
        end_unix_nano, cluster_id = valid_until(self._clock.time_unix_nano(), valid_nanos), self._cluster_id()
        newcomer = _member("supernode_id", request.supernode_id, "the address", request.target)
        self._check_is_new(newcomer.member_id)
        token = self._tokens().make(
            request.request_id,
            newcomer,
            valid_until_unix_nano=end_unix_nano,
            log_cluster_id=self._log_cluster_id,
        )
        audit_change("make join token", f"{newcomer.member_id} at {newcomer.address}")
        return pb.CreateJoinTokenResponse(
            token=token, valid_until_unix_nano=end_unix_nano, cluster_id=cluster_id, log_cluster_id=self._log_cluster_id
        )

    @errors_as_status
    async def AddSupernode(self, request: pb.AddSupernodeRequest, context: Context) -> pb.AddSupernodeResponse:
        _check_speaks_for(context, request.supernode_id)
        member, ticket = self._newcomer(request)
        index = await self._done(self._log.add_member(member, ticket=ticket, timeout=_seconds(context)))
        audit_change("add supernode", f"{member.member_id} at {member.address}")
        records, _ = self._members.records()
        return pb.AddSupernodeResponse(supernodes=records, cluster_id=self._cluster_id(), index=index)

    @errors_as_status
    async def TakeSnapshot(
        self, request: pb.TakeSnapshotRequest, context: Context
    ) -> AsyncIterator[pb.TakeSnapshotResponse]:
        if self._snapshots_under_way >= SNAPSHOTS_MAX:
            raise Overloaded(f"{SNAPSHOTS_MAX} other calls take snapshots already; try again in a moment")
        self._snapshots_under_way += 1
        try:
            backup, facts = await self._taken(stale_ok=request.stale_ok, seconds=_seconds(context))
            yield facts
            for data in backup.parts() if request.include_data else ():
                yield pb.TakeSnapshotResponse(data=data)
        finally:
            self._snapshots_under_way -= 1

    async def _taken(self, *, stale_ok: bool, seconds: float) -> tuple[replication.Backup, pb.TakeSnapshotResponse]:
        """A snapshot in the form of a backup file, and the response that describes it. Raises Unavailable."""
        began, status = self._clock.boottime_nanos(), self._log.status()
        if status.diverged_at:
            text = f"{why_diverged(status)}; its snapshot is not a valid backup; take a snapshot of another supernode"
            raise Unavailable(text, reason="SHUTTING_DOWN")
        try:
            if not stale_ok:
                await self._confirm(seconds)
            taken = await self._log.take_snapshot(timeout=seconds)
        except replication.LogUnavailable as error:
            raise Unavailable(str(error), reason="NO_QUORUM") from error
        took, now, member_id = self._clock.boottime_nanos() - began, self._clock.time_unix_nano(), self._members.self_id
        cluster_id = self._replica.read(lambda directory: directory.cluster_id)
        header = replication.BackupHeader(
            member_id=member_id, cluster_id=cluster_id, log_index=taken.log_index, time_unix_nano=now
        )
        backup = await asyncio.to_thread(replication.make_backup, header, taken.record)
        return backup, pb.TakeSnapshotResponse(
            supernode_id=member_id,
            log_index=taken.log_index,
            size_bytes=backup.size_bytes,
            sha256=backup.sha256,
            time_unix_nano=now,
            took_nanos=took,
        )

    async def _confirm(self, seconds: float) -> None:
        try:
            await self._log.confirm_read(timeout=min(seconds, QUORUM_SECONDS))
        except replication.LogUnavailable as error:
            text = f"{error}; stale_ok (--stale-ok) returns the state that this supernode holds"
            raise Unavailable(text, reason="NO_QUORUM") from error

    @errors_as_status
    async def RemoveSupernode(self, request: pb.RemoveSupernodeRequest, context: Context) -> pb.RemoveSupernodeResponse:
        if not request.supernode_id:
            raise InvalidArgument("supernode_id is empty; name the supernode to remove")
        _check_speaks_for(context, request.supernode_id)
        index = await self._done(self._log.remove_member(request.supernode_id, timeout=_seconds(context)))
        audit_change("remove supernode", request.supernode_id)
        records, _ = self._members.records()
        return pb.RemoveSupernodeResponse(supernodes=records, index=index)

    def _newcomer(self, request: pb.AddSupernodeRequest) -> tuple[Member, str]:
        if request.protocol_version != PROTOCOL_VERSION:
            text = f"the newcomer speaks version {request.protocol_version} of the wire contract, and this supernode"
            raise VersionMismatch(f"{text} speaks version {PROTOCOL_VERSION}; install the same release on both")
        highest, level = max(1, request.highest_feature_level), self._replica.feature_level
        if highest < level:
            raise VersionMismatch(too_old(request.supernode_id, highest, level))
        member = _member("supernode_id", request.supernode_id, "the address", request.endpoint.target)
        ticket = self._tokens().check(request.token, member, now_unix_nano=self._clock.time_unix_nano())
        return member, ticket

    def _check_is_new(self, member_id: str) -> None:
        """Raises InvalidArgument for an id that can never join. The leader checks the id again in AddSupernode."""
        status = self._log.status()
        if member_id in status.former_ids:
            text = f"{member_id} was a member before; a removed id is never used again: let it join under a new one"
            raise InvalidArgument(text)
        if any(member.member_id == member_id for member in status.members):
            raise InvalidArgument(f"{member_id} is a member already; a newcomer, or a wiped supernode, needs a new id")

    def _tokens(self) -> JoinTokens:
        """The join tokens of this cluster. Raises Unavailable before the cluster is founded."""
        self._cluster_id()
        return JoinTokens(self._replica.read(lambda directory: directory.join_key))

    async def _done(self, change: Awaitable[int]) -> int:
        """The log position of a change of the members. Raises the error of the contract for each error of the log."""
        try:
            return await change
        except replication.NotLeading as error:
            raise not_leader(self._log.status()) from error
        except replication.ChangeUnderWay as error:
            raise Overloaded(f"{error}; try again in a moment") from error
        except replication.TicketSpent as error:
            raise PermissionDenied(str(error), reason="UNAUTHENTICATED") from error
        except replication.ReleaseOutdated as error:
            raise VersionMismatch(str(error)) from error
        except replication.ChangeRefused as error:
            raise InvalidArgument(str(error)) from error
        except replication.LogUnavailable as error:
            raise Unavailable(str(error), reason="NO_QUORUM") from error
        except replication.OutcomeUnknown as error:
            raise Unavailable(f"{error}; repeat it, or ask ListSupernodes", reason="AMBIGUOUS") from error

    def _cluster_id(self) -> str:
        cluster_id = self._replica.read(lambda directory: directory.cluster_id)
        if not cluster_id:
            raise Unavailable("the cluster is just being founded; try again in a moment", reason="NO_QUORUM")
        return cluster_id


def _check_speaks_for(context: Context, member_id: str) -> None:
    """Raises PermissionDenied for the certificate of another supernode.

    Without this check, one supernode could remove all others, and then decide alone about the directory. Operators may
    name any supernode.
    """
    caller = caller_identity(context)
    if caller is not None and caller.role is Role.SUPERNODE and caller.name != member_id:
        raise PermissionDenied(
            f"{caller} may not add or remove supernode {member_id}: a supernode does so only for itself; use the "
            "certificate of an operator"
        )


def _member(id_field: str, supernode_id: str, target_field: str, target: str) -> Member:
    """The member of a request. Raises InvalidArgument."""
    if not 0 < len(supernode_id) <= MEMBER_ID_CHARACTERS_MAX:
        raise InvalidArgument(f"{id_field} must have 1 to {MEMBER_ID_CHARACTERS_MAX} characters")
    try:
        return Member(member_id=supernode_id, address=parse_target(target))
    except ValueError as error:
        raise InvalidArgument(f"{target_field} is {target!r}; it must be {error}") from error


def _seconds(context: Context) -> float:
    """The seconds that this call may wait for the newcomer and the other supernodes."""
    call_seconds = context.time_remaining()
    if call_seconds is None:
        return WAIT_SECONDS_MAX
    return float(min(WAIT_SECONDS_MAX, max(call_seconds - ANSWER_SECONDS, call_seconds / 2)))
