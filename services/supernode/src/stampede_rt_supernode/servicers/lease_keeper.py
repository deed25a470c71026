"""Grants, renews and ends the leases of hosts and peers, while this supernode leads.

A thin shell around `core.lease`.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Callable
from itertools import chain
from typing import NamedTuple, TypeVar

from stampede_rt.errors import HostNotFound, LeaseExpired, NotLeader, StampedeError, Unavailable
from stampede_rt.values.peering import ClockOffset
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.cluster_ids import new_cluster_id
from stampede_rt_supernode.core.cluster.commands import BeginTenure, MarkTime, TenureBegun, TimeMarked
from stampede_rt_supernode.core.cluster.feature_levels import FIRST_LEVEL
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.hosts.commands import ExpireHost, HostExpired
from stampede_rt_supernode.core.hosts.transitions import check_boot
from stampede_rt_supernode.core.kept_answers import MARK_NANOS
from stampede_rt_supernode.core.lease import LEASE_TTL_NANOS, LeaseTable
from stampede_rt_supernode.core.lookups import host_by_id
from stampede_rt_supernode.core.peers.commands import ExpirePeers, PeerLease, PeersExpired
from stampede_rt_supernode.core.peers.transitions import check_peer_boot
from stampede_rt_supernode.core.records import ID_BYTES, HostRecord, PeerRecord
from stampede_rt_supernode.core.validation import check_id
from stampede_rt_supernode.joining.join_tokens import KEY_BYTES
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReplicatedLog, ReplicationStatus
from stampede_rt_supernode.servicers.followed_peers import FollowedPeers
from stampede_rt_supernode.servicers.host_loads import HostLoads
from stampede_rt_supernode.servicers.submission import Submission

logger = logging.getLogger(__name__)

TICK_SECONDS = 0.1
PROPOSAL_SECONDS = 5.0  # the time that a tick waits for the outcome of a command
PARALLEL_ENDINGS_MAX = 64  # the most commands under way that each end the lease of a host
PEERS_PER_ENTRY_MAX = 256  # the most leases of peers that one command ends

T = TypeVar("T", HostRecord, PeerRecord)


class PeerRenewal(NamedTuple):
    """A peer's renewed lease, and the leader's time, by which the peer measures its own clock."""

    ttl_nanos: int
    tenure: int
    time_unix_nano: int
    supernode_id: str
    held_nanos: int  # the time from the arrival of the renewal to its answer


class LeaseKeeper:
    """The leases of hosts and peers. Use it on one event loop.

    Call `tick` again and again, and `renew` or `renew_peer` for each renewal.
    """

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
        self.loads = HostLoads(replica, submission, clock)
        self._hosts = LeaseTable()
        self._peers = LeaseTable()
        self._followed_peers = FollowedPeers(self._peers, replica, lambda: self._let_others_run())
        # The log position of the last mark of time, and when this leader first saw the mark, or began to lead.
        self._last_mark = self._marked_nanos = 0
        # The id that the founder gave the cluster.
        self.founding_cluster_id = ""
        # Whether a restored cluster accepts callers that name the former cluster.
        self.serves_former_cluster = False
        # Whether the cluster keeps everything in memory. If the first leader makes the cluster's id, the id shows this.
        self.in_memory = False

    async def run(self) -> None:
        """Tick until cancelled."""
        while True:
            await self.tick()
            await asyncio.sleep(TICK_SECONDS)

    async def tick(self) -> None:
        """Perform the work that is due on the leases, if this supernode leads. Drop all leases if another one leads.

        The first tick of a tenure takes over the leases. The later ticks end due leases. The next tick repeats failed
        work.
        """
        status = self._log.status()
        try:
            if not status.is_leader:
                self._resign()
                for _ in chain(self._hosts.freeing(), self._peers.freeing()):
                    await self._let_others_run()
            elif self._hosts.tenure != status.tenure:
                await self._take_over(status)
            else:
                await self._mark_time()
                await self._end_due_leases()
                await self._end_due_peers()
                await self.loads.tick(self._hosts.tenure)
        except StampedeError as error:
            logger.warning(
                "cannot end leases at present",
                extra={"event": "leases_wait", "reason": error.reason, "cause": error.message},
            )

    def _resign(self) -> None:
        self._hosts.resign()
        self._peers.resign()
        self.loads.forget()

    async def _take_over(self, status: ReplicationStatus) -> None:
        self._resign()
        cluster_id = self._replica.read(lambda directory: directory.cluster_id)
        operation = BeginTenure(
            tenure=status.tenure,
            supernode_id=status.self_id,
            new_cluster_id=self.founding_cluster_id or new_cluster_id(in_memory=self.in_memory),
            new_lease_ttl_nanos=self._founding_ttl_nanos,
            # A restored cluster gets a new id. So front-ends do not mistake the former cluster for the restored one.
            founded_anew=bool(cluster_id and self.founding_cluster_id and cluster_id != self.founding_cluster_id),
            takes_over=self.serves_former_cluster,
            new_feature_level=max(FIRST_LEVEL, status.level_of_members),
            new_join_key=secrets.token_bytes(KEY_BYTES),
            new_token_key=secrets.token_bytes(KEY_BYTES),
        )
        begun = await self._submission.submit(operation, TenureBegun, op_id=_op_id(), seconds=PROPOSAL_SECONDS)
        if begun.tenure != status.tenure or self._log.status().tenure != status.tenure:
            return  # another supernode leads by now
        hosts, ttl_nanos = self._replica.read(lambda directory: (_live(directory), directory.lease_ttl_nanos))
        self._followed_peers.begin()
        now = self._marked_nanos = self._clock.boottime_nanos()
        self._hosts.lead(status.tenure, hosts, now, ttl_nanos=ttl_nanos)
        self._peers.lead(status.tenure, (), now, ttl_nanos=ttl_nanos)
        await self._followed_peers.follow(now)
        peers = self._replica.read(lambda directory: directory.tables.peers.live_count)
        logger.info("leading", extra={"event": "leading", "tenure": status.tenure, "hosts": len(hosts), "peers": peers})
        if ttl_nanos != self._founding_ttl_nanos:
            ttls = {"cluster_ttl_nanos": ttl_nanos, "ignored_ttl_nanos": self._founding_ttl_nanos}
            extra = {"event": "lease_ttl_ignored", **ttls}
            logger.warning(
                "the cluster was founded with another lease TTL; this supernode ignores its own setting", extra=extra
            )

    async def _mark_time(self) -> None:
        """Add a mark of time to the log if one is due. None is due while the directory keeps no answers."""
        now = self._clock.boottime_nanos()
        kept, last_mark = self._replica.read(lambda one: (len(one.kept_answers), one.kept_answers.last_mark))
        if last_mark != self._last_mark:
            self._last_mark, self._marked_nanos = last_mark, now
        if kept and now - self._marked_nanos >= MARK_NANOS:
            operation = MarkTime(tenure=self._hosts.tenure, after_index=last_mark)
            await self._submission.submit(operation, TimeMarked, op_id=_op_id(), seconds=PROPOSAL_SECONDS)

    async def _end_due_leases(self) -> None:
        now = self._clock.boottime_nanos()
        self._hosts.follow(self._replica.read(_live), now)
        due = self._hosts.due(now)
        for start in range(0, len(due), PARALLEL_ENDINGS_MAX):
            await asyncio.gather(*(self._end(*lease) for lease in due[start : start + PARALLEL_ENDINGS_MAX]))

    async def _end(self, host_id: bytes, boot_incarnation: int, registered_index: int) -> None:
        operation = ExpireHost(
            host_id=host_id,
            boot_incarnation=boot_incarnation,
            registered_index=registered_index,
            tenure=self._hosts.tenure,
        )
        ended = await self._submission.submit(operation, HostExpired, op_id=_op_id(), seconds=PROPOSAL_SECONDS)
        logger.info("lease ended", extra={"event": "host_lease_ended", "host_id": host_id, "expired": ended.expired})

    async def _end_due_peers(self) -> None:
        now = self._clock.boottime_nanos()
        await self._followed_peers.follow(now)
        due = self._peers.due(now)
        while self._peers.is_behind(now):
            await self._let_others_run()
            due = self._peers.due(now)
        leases = [PeerLease(peer_id=one, boot_incarnation=boot, registered_index=at) for one, boot, at in due]
        for start in range(0, len(leases), PEERS_PER_ENTRY_MAX):
            part = tuple(leases[start : start + PEERS_PER_ENTRY_MAX])
            operation = ExpirePeers(leases=part, tenure=self._peers.tenure)
            ended = await self._submission.submit(operation, PeersExpired, op_id=_op_id(), seconds=PROPOSAL_SECONDS)
            logger.info(
                "leases of peers ended",
                extra={"event": "peer_leases_ended", "due": len(operation.leases), "expired": ended.expired},
            )

    @staticmethod
    async def _let_others_run() -> None:
        await asyncio.sleep(0)

    async def renew(
        self, host_id: bytes, boot_incarnation: int, registered_index: int, *, seconds: float
    ) -> tuple[int, int]:
        """Renew the lease of a host. Returns its TTL in nanoseconds and the tenure.

        `registered_index`: the registration that the host knows; 0: it does not state one. Raises NotLeader,
        LeaseExpired (register again), or Unavailable with reason NO_QUORUM.
        """
        return await self._renew(
            self._hosts, lambda: self._registered(host_id, boot_incarnation, registered_index), seconds
        )

    async def renew_peer(
        self, peer_id: bytes, boot_incarnation: int, clock: ClockOffset | None, *, seconds: float
    ) -> PeerRenewal:
        """Renew the lease of a peer. `clock`: the peer's report of its clock; None if the peer did not report it."""
        received = self._clock.boottime_nanos()
        ttl_nanos, tenure = await self._renew(
            self._peers, lambda: self._registered_peer(peer_id, boot_incarnation), seconds, clock
        )
        self_id = self._log.status().self_id
        # Read before the time in the answer: `held_nanos` may be a little too short, but never too long.
        held = self._clock.boottime_nanos() - received
        return PeerRenewal(ttl_nanos, tenure, self._clock.time_unix_nano(), self_id, held)

    def note_clock(self, peer: PeerRecord, clock: ClockOffset | None) -> None:
        """Keep the clock report of a peer, if this supernode leads and `peer` is still the directory's record of it."""
        recorded = self._replica.read(lambda directory: directory.tables.peers.by_id.get(peer.peer_id))
        if clock is not None and peer == recorded:
            self._peers.note_clock(peer, clock, self._clock.boottime_nanos())

    def clock_of(self, peer: PeerRecord) -> ClockOffset | None:
        """The last clock report of a peer to this supernode as the leader; None if there is none."""
        return self._peers.clock(peer)

    async def _renew(
        self, table: LeaseTable, holder: Callable[[], T], seconds: float, clock: ClockOffset | None = None
    ) -> tuple[int, int]:
        received = self._clock.boottime_nanos()
        tenure = self.check_leads()
        await self._submission.confirm(seconds=seconds)
        self.check_leads(tenure)
        found = holder()
        if not table.renew(found, received, clock):
            raise _lapsed(found)
        return table.ttl_nanos, tenure

    def check_leads(self, since: int = 0) -> int:
        """The tenure under which this supernode grants leases.

        `since`: the tenure that must not have ended; 0 if any tenure will do. Raises NotLeader. Raises Unavailable with
        reason NO_QUORUM while this supernode takes over, or if the tenure has changed.
        """
        status = self._log.status()
        if not status.is_leader:
            raise not_leader(status)
        if self._hosts.tenure != status.tenure or since not in (0, status.tenure):
            text = f"supernode {status.self_id} is just taking over as leader; try again in a moment"
            raise Unavailable(text, reason="NO_QUORUM")
        return status.tenure

    def _registered(self, host_id: bytes, boot_incarnation: int, registered_index: int) -> HostRecord:
        try:
            host = self._replica.read(lambda directory: host_by_id(directory.tables, host_id))
        except HostNotFound as error:
            raise _unknown("host", host_id) from error
        check_boot(host, boot_incarnation)
        if not host.alive:
            raise _lapsed(host)
        if registered_index not in (0, host.registered_index):
            # An old request came late. The lease had ended, and other hosts may own the host's channels.
            text = f"host {host.name} was registered again by a request whose answer it did not get; register it again"
            raise LeaseExpired(text, metadata={"host": host.name})
        return host

    def _registered_peer(self, peer_id: bytes, boot_incarnation: int) -> PeerRecord:
        check_id(peer_id, "peer_id")
        peer = self._replica.read(lambda directory: directory.tables.peers.by_id.get(peer_id))
        if peer is None:
            raise _unknown("peer", peer_id)
        check_peer_boot(peer, boot_incarnation)
        if not peer.alive:
            raise _lapsed(peer)
        return peer


def not_leader(status: ReplicationStatus) -> StampedeError:
    """The error that sends the caller to the leader, or to another supernode if there is none."""
    leader = next((member for member in status.members if member.member_id == status.leader_id), None)
    if leader is None or leader.member_id == status.self_id:
        text = f"supernode {status.self_id} knows no leader at present; try another supernode, or again in a moment"
        return Unavailable(text, reason="NO_QUORUM")
    text = f"supernode {status.self_id} does not lead; ask the leader, {leader.member_id} at {leader.address}"
    return NotLeader(text, metadata={"leader": leader.member_id, "leader_endpoint": leader.address})


def _lapsed(holder: HostRecord | PeerRecord) -> LeaseExpired:
    return _without_lease("host" if isinstance(holder, HostRecord) else "peer", holder.name or holder.holder_id.hex())


def _unknown(kind: str, holder_id: bytes) -> LeaseExpired:
    return _without_lease(kind, holder_id.hex())


def _without_lease(kind: str, shown: str) -> LeaseExpired:
    text = f"{kind} {shown} has no lease; it ended, or the {kind} left; register it again"
    return LeaseExpired(text, metadata={kind: shown})


def _live(directory: Directory) -> list[HostRecord]:
    return list(directory.tables.live_hosts())


def _op_id() -> bytes:
    return secrets.token_bytes(ID_BYTES)
