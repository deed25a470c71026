"""What the leader does about leases: takes them over, prolongs them, ends them. The thin shell around `lease`."""

from __future__ import annotations

import asyncio
import logging
import secrets

from stampede_rt.errors import HostNotFound, LeaseExpired, NotLeader, StampedeError, Unavailable
from stampede_rt_runtime.clock import HostClock
from stampede_rt_supernode.core.commands import BeginTenure, ExpireHost, HostExpired, TenureBegun
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.host_transitions import check_boot
from stampede_rt_supernode.core.lease import LEASE_TTL_NANOS, LeaseTable
from stampede_rt_supernode.core.lookups import host_by_id
from stampede_rt_supernode.core.records import ID_BYTES, Host
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReplicatedLog, ReplicationStatus
from stampede_rt_supernode.servicers.submission import Submission

logger = logging.getLogger(__name__)

TICK_SECONDS = 0.1
PROPOSAL_SECONDS = 5.0
ENDINGS_AT_ONCE_MAX = 64


class LeaseKeeper:
    """`tick` is called again and again; `renew` for each renewal that arrives. On one event loop."""

    def __init__(
        self,
        log: ReplicatedLog,
        replica: DirectoryReplica,
        submission: Submission,
        *,
        clock: HostClock,
        founding_ttl_nanos: int = LEASE_TTL_NANOS,
    ) -> None:
        self._log = log
        self._replica = replica
        self._submission = submission
        self._clock = clock
        self._founding_ttl_nanos = founding_ttl_nanos
        self._table = LeaseTable()
        # The id that the founder gave the cluster; left empty, the first leader makes one.
        self.founding_cluster_id = ""

    async def run(self) -> None:
        """Tick until cancelled."""
        while True:
            await self.tick()
            await asyncio.sleep(TICK_SECONDS)

    async def tick(self) -> None:
        """Follow the leadership; under one's own, end what is due. What fails is tried again at the next tick."""
        status = self._log.status()
        try:
            if not status.is_leader:
                self._table.resign()
            elif self._table.tenure != status.tenure:
                await self._take_over(status)
            else:
                await self._end_due_leases()
        except StampedeError as error:
            logger.warning("leases wait", extra={"reason": error.reason, "cause": error.message})

    async def _take_over(self, status: ReplicationStatus) -> None:
        self._table.resign()
        deed = BeginTenure(
            tenure=status.tenure,
            supernode_id=status.self_id,
            new_cluster_id=self.founding_cluster_id or secrets.token_hex(16),
            new_lease_ttl_nanos=self._founding_ttl_nanos,
        )
        begun = await self._submission.submit(deed, TenureBegun, op_id=_op_id(), seconds=PROPOSAL_SECONDS)
        if begun.tenure != status.tenure or self._log.status().tenure != status.tenure:
            return  # another one leads by now
        hosts, ttl_nanos = self._replica.read(lambda directory: (_live(directory), directory.lease_ttl_nanos))
        self._table.lead(status.tenure, hosts, self._clock.boottime_nanos(), ttl_nanos=ttl_nanos)
        logger.info("leading", extra={"tenure": status.tenure, "hosts": len(hosts)})
        if ttl_nanos != self._founding_ttl_nanos:
            extra = {"cluster_ttl_nanos": ttl_nanos, "ignored_ttl_nanos": self._founding_ttl_nanos}
            logger.warning("the cluster was founded with another lease TTL, which holds", extra=extra)

    async def _end_due_leases(self) -> None:
        now = self._clock.boottime_nanos()
        self._table.follow(self._replica.read(_live), now)
        due = self._table.due(now)
        for start in range(0, len(due), ENDINGS_AT_ONCE_MAX):
            await asyncio.gather(*(self._end(*lease) for lease in due[start : start + ENDINGS_AT_ONCE_MAX]))

    async def _end(self, host_id: bytes, boot_incarnation: int, registered_index: int) -> None:
        deed = ExpireHost(
            host_id=host_id,
            boot_incarnation=boot_incarnation,
            registered_index=registered_index,
            tenure=self._table.tenure,
        )
        ended = await self._submission.submit(deed, HostExpired, op_id=_op_id(), seconds=PROPOSAL_SECONDS)
        logger.info("lease ended", extra={"host_id": host_id, "expired": ended.expired})

    async def renew(self, host_id: bytes, boot_incarnation: int, *, seconds: float) -> tuple[int, int]:
        """Prolong a lease; returns its TTL in nanoseconds and the tenure.

        Raises NotLeader, LeaseExpired (register again), or Unavailable with reason NO_QUORUM.
        """
        received = self._clock.boottime_nanos()
        tenure = self._check_leads(0)
        await self._submission.confirm(seconds=seconds)
        self._check_leads(tenure)
        host = self._registered(host_id, boot_incarnation)
        if not self._table.renew(host, received):
            raise _lapsed(host.name)
        return self._table.ttl_nanos, tenure

    def _check_leads(self, since: int) -> int:
        """The tenure under which leases are granted; another one than `since` (0: any) is not good enough."""
        status = self._log.status()
        if not status.is_leader:
            raise not_leader(status)
        if self._table.tenure != status.tenure or since not in (0, status.tenure):
            text = f"supernode {status.self_id} is just taking over as leader; try again in a moment"
            raise Unavailable(text, reason="NO_QUORUM")
        return status.tenure

    def _registered(self, host_id: bytes, boot_incarnation: int) -> Host:
        try:
            host = self._replica.read(lambda directory: host_by_id(directory.tables, host_id))
        except HostNotFound as error:
            raise _lapsed(host_id.hex()) from error
        check_boot(host, boot_incarnation)
        if not host.alive:
            raise _lapsed(host.name)
        return host


def not_leader(status: ReplicationStatus) -> StampedeError:
    """The error that sends the caller to the leader, or away if there is none."""
    leader = next((member for member in status.members if member.member_id == status.leader_id), None)
    if leader is None or leader.member_id == status.self_id:
        text = f"supernode {status.self_id} knows no leader at present; try another supernode, or again in a moment"
        return Unavailable(text, reason="NO_QUORUM")
    text = f"supernode {status.self_id} does not lead; ask the leader, {leader.member_id} at {leader.address}"
    return NotLeader(text, metadata={"leader": leader.member_id, "leader_endpoint": leader.address})


def _lapsed(host: str) -> LeaseExpired:
    text = f"host {host} has no lease; it ended, or the host left; register it again"
    return LeaseExpired(text, metadata={"host": host})


def _live(directory: Directory) -> list[Host]:
    return list(directory.tables.live_hosts())


def _op_id() -> bytes:
    return secrets.token_bytes(ID_BYTES)
