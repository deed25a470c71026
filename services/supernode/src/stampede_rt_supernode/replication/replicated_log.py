"""The replicated log for asyncio: opens a replica, its thread and its network, and passes calls to them."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import grpc.aio

from stampede_rt.v1.raft_service_pb2 import RaftHello
from stampede_rt_runtime.metrics.families import Durations
from stampede_rt_supernode.replication.interface import (
    LogUnavailable,
    Member,
    OutcomeUnknown,
    ReplicationStatus,
    StateMachine,
    TakenSnapshot,
)
from stampede_rt_supernode.replication.network.hello import introduction
from stampede_rt_supernode.replication.network.links import PeerLinks
from stampede_rt_supernode.replication.network.peer_link import Dial
from stampede_rt_supernode.replication.network.refusals import RefusalGrounds
from stampede_rt_supernode.replication.network.servicer import RaftServicer
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome, MemberChange
from stampede_rt_supernode.replication.rules.proposals import Outcome, Proposal
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotOutcome, SnapshotRequest
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.shared_reads import SharedReads
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore, holds_store
from stampede_rt_supernode.replication.storage.store import REJOIN, MemoryStore, Store, StoreRefused
from stampede_rt_supernode.replication.threads.loop_bridge import LoopBridge
from stampede_rt_supernode.replication.threads.tick_thread import TickThread, end_process
from stampede_rt_supernode.replication.threads.worker_thread import RunInBackground, WorkerThread

T = TypeVar("T")


class PySyncObjLog:
    """A ReplicatedLog over PySyncObj. Use it only on the event loop on which `open_replicated_log` made it."""

    def __init__(
        self,
        replica: RaftReplica,
        thread: TickThread,
        bridge: LoopBridge,
        links: PeerLinks,
        worker: WorkerThread,
        *,
        reads_max: int,
    ) -> None:
        self._worker = worker
        self._replica = replica
        self._thread = thread
        self._bridge = bridge
        self._links = links
        self._reads = SharedReads(replica.read, bridge, waiting_max=reads_max)
        self._servicer: RaftServicer | None = None
        self._closed = False

    def start(self, settings: ReplicationSettings, server: grpc.aio.Server, stores: KnownStores) -> None:
        """Register the Raft service, connect to the other members, and begin to tick. Call it once."""
        replica = self._replica
        self._servicer = RaftServicer(settings, replica, stores)
        self._servicer.add_to_server(server)

        def introduce(to: str) -> RaftHello:
            return introduction(
                settings,
                to,
                store_id=stores.own,
                durable_end=replica.durable_end,
                roster=replica.roster,
                highest_level=replica.highest_level,
            )

        def others_and_leader() -> tuple[set[str], str | None]:
            others = {member.member_id for member in replica.roster.members} - {settings.self_member.member_id}
            return others, replica.status().leader_id

        self._links.others_and_leader, self._links.on_refusal_confirmed = others_and_leader, stores.note_own_refusal
        self._links.on_protocol_fault = self._servicer.expel
        self._links.start(replica.deliver, replica.roster.peers, introduce)
        self._thread.start(replica)

    async def propose(self, command: bytes, *, timeout: float) -> bytes:
        """See ReplicatedLog. Without a leader a command waits for one, up to `timeout`."""
        self._refuse_when_closed()
        answer: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        proposal = Proposal(command, time.monotonic() + timeout, self._result_setter(answer))
        self._replica.propose(proposal)
        try:
            async with asyncio.timeout(timeout):
                outcome = await answer
        except TimeoutError:
            proposal.abandoned = True
            if proposal.submitted:
                raise OutcomeUnknown(f"no answer within {timeout} s; the command may still be applied") from None
            raise LogUnavailable(f"no leader took the command within {timeout} s") from None
        except asyncio.CancelledError:
            proposal.abandoned = True
            raise
        if isinstance(outcome, bytes):
            return outcome
        raise outcome

    async def confirm_read(self, *, timeout: float) -> int:
        """See ReplicatedLog.

        Adds no entry to the log. Waiting calls share one read, so a follower asks the leader once for all of them.
        """
        self._refuse_when_closed()
        index = await self._reads.confirm(timeout)
        if index is None:
            raise LogUnavailable(f"no majority confirmed the read within {timeout} s")
        return index

    def status(self) -> ReplicationStatus:
        """See ReplicatedLog."""
        status, links = self._replica.status(), self._links
        if (silent := self._thread.stuck_seconds()) > 0.0:
            # The thread made this status before it got stuck. Since then the others may have elected another leader.
            status = replace(status, leader_id=None, is_leader=False, tenure=0, disk_silent_seconds=silent)
        status = replace(status, former_ids=self._replica.roster.former_ids)
        refused_members = self._servicer.refused() if self._servicer is not None else {}
        refusing_members = {**links.outdated.words_by_id, **links.refusals.words_by_id}
        confirmed, release_refusal = links.refusals.confirmed, links.outdated.why
        if not (refusing_members or confirmed or release_refusal or links.other_cluster or refused_members):
            return status
        return replace(
            status,
            removed=confirmed is RefusalGrounds.REMOVED,
            has_lost_store=confirmed in (RefusalGrounds.ANOTHER_STORE, RefusalGrounds.NO_STORE),
            has_old_store=confirmed is RefusalGrounds.OLDER_STORE,
            other_cluster=links.other_cluster,
            release_refusal=release_refusal,
            refused_members=refused_members,
            refusing_members=refusing_members,
        )

    def write_times(self) -> Durations:
        """See ReplicatedLog."""
        return self._replica.write_times()

    async def add_member(self, member: Member, *, ticket: str = "", timeout: float) -> int:
        """See ReplicatedLog."""
        return await self._change(member, is_removal=False, timeout=timeout, ticket=ticket)

    async def remove_member(self, member_id: str, *, timeout: float) -> int:
        """See ReplicatedLog."""
        return await self._change(Member(member_id=member_id, address=""), is_removal=True, timeout=timeout)

    async def _change(self, member: Member, *, is_removal: bool, timeout: float, ticket: str = "") -> int:
        self._refuse_when_closed()
        answer: asyncio.Future[ChangeOutcome] = asyncio.get_running_loop().create_future()
        self._replica.change_members(MemberChange(member, is_removal, self._result_setter(answer), ticket))
        try:
            async with asyncio.timeout(timeout):
                outcome = await answer
        except TimeoutError:
            raise OutcomeUnknown(f"the change was not done within {timeout} s; it is still under way") from None
        if isinstance(outcome, int):
            return outcome
        raise outcome

    async def hand_over(self, *, timeout: float) -> bool:
        """See ReplicatedLog."""
        self._refuse_when_closed()
        answer: asyncio.Future[bool] = asyncio.get_running_loop().create_future()
        self._replica.change_members(HandOver(self._result_setter(answer)))
        try:
            async with asyncio.timeout(timeout):
                return await answer
        except TimeoutError:
            return not self.status().is_leader

    async def take_snapshot(self, *, timeout: float) -> TakenSnapshot:
        """See ReplicatedLog."""
        self._refuse_when_closed()
        answer: asyncio.Future[SnapshotOutcome] = asyncio.get_running_loop().create_future()
        self._replica.take_snapshot(SnapshotRequest(self._result_setter(answer)))
        try:
            async with asyncio.timeout(timeout):
                outcome = await answer
        except TimeoutError:
            raise LogUnavailable(f"no snapshot was written within {timeout:.1f} s") from None
        if isinstance(outcome, LogUnavailable):
            raise outcome
        return TakenSnapshot(log_index=outcome.last_log_index, record=outcome.record)

    async def close(self) -> None:
        """See ReplicatedLog. Waiting calls end with LogUnavailable or OutcomeUnknown. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._reads.close()
        if self._servicer is not None:
            self._servicer.close()
        await self._links.close()
        await asyncio.get_running_loop().run_in_executor(None, self._thread.stop)
        self._worker.close()

    def _refuse_when_closed(self) -> None:
        if self._closed:
            raise LogUnavailable("this replica is closed")

    def _result_setter(self, answer: asyncio.Future[T]) -> Callable[[T], None]:
        """Returns a function that sets the result of `answer`. Any thread may call it; the loop sets the result."""

        def set_result(outcome: T) -> None:
            if not answer.done():
                answer.set_result(outcome)

        return lambda outcome: self._bridge.post(lambda: set_result(outcome))


async def open_replicated_log(
    settings: ReplicationSettings,
    state_machine: StateMachine,
    dial: Dial,
    server: grpc.aio.Server,
    *,
    on_fatal: Callable[[BaseException], None] = end_process,
) -> PySyncObjLog:
    """Load this replica's state, register its service with `server`, and take part in the log.

    The caller binds `server` before this call, so that its address is known, and starts it afterwards. The caller stops
    `server` after it has closed the log. `dial(address)` makes a new channel with the cluster's credentials and with
    CHANNEL_OPTIONS; the log closes that channel. From now on the log drives `state_machine` on its own thread. The log
    calls `on_fatal` if it cannot continue; by default that ends the process. Raises StoreRefused, StoreDamaged,
    LibraryMismatch, and the errors of `state_machine` for its stored snapshot (ReleaseTooOld among them).
    """
    bridge = LoopBridge(asyncio.get_running_loop())
    links = PeerLinks(settings, dial, bridge, on_fatal)
    thread = TickThread(on_fatal=on_fatal)
    worker = WorkerThread()
    had_store = settings.data_dir is not None and holds_store(settings.data_dir)
    replica = await asyncio.to_thread(_open_replica, settings, state_machine, links, thread.wake, worker.run)
    try:
        stores = await asyncio.to_thread(KnownStores.open, settings.data_dir, had_store=had_store)
        if stores.refused:
            raise StoreRefused(f"{settings.data_dir} cannot be used any more: {stores.refused}: {REJOIN}")
    except BaseException:
        replica.close()
        raise
    log = PySyncObjLog(replica, thread, bridge, links, worker, reads_max=settings.reads_max)
    log.start(settings, server, stores)
    return log


def _open_replica(
    settings: ReplicationSettings,
    state_machine: StateMachine,
    links: PeerLinks,
    wake: Callable[[], None],
    run_in_background: RunInBackground,
) -> RaftReplica:
    store = _open_store(settings)
    try:
        return RaftReplica(
            settings,
            state_machine,
            store=store,
            network=links,
            clock=time.monotonic,
            random_source=random.SystemRandom(),
            wake=wake,
            run_in_background=run_in_background,
        )
    except BaseException:
        store.close()
        raise


def _open_store(settings: ReplicationSettings) -> Store:
    if settings.data_dir is None:
        return MemoryStore()
    return SqliteStore(
        settings.data_dir,
        cluster_id=settings.cluster_id,
        member_id=settings.self_member.member_id,
        create=settings.create,
    )
