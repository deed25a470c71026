"""Hosts with queues around a directory, in virtual time. Queues, replicas and moves run the product's code.

There are two queues with the same replicas: `jobs`, and the queue of its dead letters.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from functools import lru_cache, partial
from typing import Any

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.transports.grpc_options import ENQUEUE_METHOD
from stampede_rt.v1 import migration_service_pb2
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.cluster.records import recorded_queue
from stampede_rt_channel_host.copies.queues.queue_arrivals import QueueArrivals
from stampede_rt_channel_host.copies.queues.queue_feed_servicer import QueueFeeds
from stampede_rt_channel_host.copies.queues.queue_handover import QueueHandovers
from stampede_rt_channel_host.copies.queues.queue_replica_keeper import QueueReplicaKeeper
from stampede_rt_channel_host.copies.replica_directory import FeedSource, ListedReplica, ListedReplicas
from stampede_rt_channel_host.core.records import RecordedQueue, ResolvedQueue
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicaChange
from stampede_rt_channel_host.queues.dead_letters import DeadLetterMover
from stampede_rt_channel_host.queues.queue_servicer import QueueServicer
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.sweep import sweep_queues_forever
from stampede_rt_supernode.codecs.queue_codec import queue_record
from stampede_rt_supernode.core.commands import Operation
from stampede_rt_supernode.core.moves.commands import CommitQueueMove, QueueMoveCommitted
from stampede_rt_supernode.core.records import QueueRecord, ReplicaKind, ReplicaRecord
from stampede_rt_supernode.core.replicas.commands import AddReplica, RemoveReplica, SetReplicaInSync
from stampede_rt_supernode.core.replicas.copied_subjects import Copied
from tests.robustness.moves.two_hosts import World
from tests.robustness.takeovers.streams import Connection, Method
from tests.robustness.takeovers.world import Cluster, LeasedHost
from tests.support.supernode.operations import id_of, open_queue
from tests.support.virtual_time import VirtualClock

FEED, HAND_OVER = "/stampede_rt.v1.MigrationService/FeedQueue", "/stampede_rt.v1.MigrationService/HandOverQueue"
TAKE = "/stampede_rt.v1.QueueService/Take"
WATCH_SECONDS_MAX = 0.2


class QueueHost(LeasedHost):
    """A host with queues."""

    def __init__(self, world: World, number: int, boot: int = 1) -> None:
        super().__init__(world, number, boot)
        directory: Any = DirectoryOfQueues(self)
        self.queues = QueueStore(
            self.identity, directory, self.store.memory, now=self.store.now, lease_held=self.holds_lease,
            scheduler=self.store.scheduler, on_dead_letters=lambda hosted: self.dead_letters.new_dead_letters(hosted),
        )  # fmt: skip
        self.dead_letters = DeadLetterMover(
            directory, self.dial, may_move=self.queues.holds, on_defect=self.cluster.defects.append
        )
        self.queue_replicas = QueueReplicaKeeper(self.identity, self.queues, directory, self.dial)
        self.arrivals = QueueArrivals(self.identity, self.queues, directory, self.dial)
        callers: Any = _AnyCaller()
        handovers = QueueHandovers(self.identity, self.queues, directory, self.outgoing, callers)
        feeds = QueueFeeds(self.identity, self.queues, directory, callers)
        servicer: Any = QueueServicer(self.queues, OpenStreams())
        self.methods = {
            FEED: Method(feeds.serve, migration_service_pb2.FeedQueueRequest.FromString),
            HAND_OVER: Method(handovers.serve, migration_service_pb2.HandOverQueueRequest.FromString),
            ENQUEUE_METHOD: Method(partial(servicer.enqueue, None)),
            TAKE: Method(partial(servicer.take, None)),
        }

    @property
    def cluster(self) -> QueueCluster:
        assert isinstance(self.world, QueueCluster)
        return self.world

    def background(self) -> tuple[Coroutine[Any, Any, None], ...]:
        queue_tasks = sweep_queues_forever(self.queues), self.queue_replicas.drop_unneeded_forever(), self.watch()
        return (*super().background(), *queue_tasks)

    def tasks(self) -> list[asyncio.Task[Any]]:
        move_tasks = [*self.arrivals._moves.values()]
        return [*super().tasks(), *move_tasks, *self.queue_replicas._tasks, *self.dead_letters._tasks.values()]

    def dial(self, target: str) -> Any:
        host = self.world.hosts[int(target.removeprefix("host-"))]
        assert isinstance(host, QueueHost)
        return Connection(self.cluster, host, host.methods, self, over_sockets={FEED})

    async def registered(self) -> None:
        owned = [one for one in self.cluster.queues() if one.host_id == self.identity.host_id]
        await self.store.scheduler.do(self.queues.registering(owned, is_complete=True))

    def fence(self) -> None:
        super().fence()
        self.queues.fence()

    async def watch(self) -> None:
        """Follow the changes of the queues in the directory."""
        seen: dict[bytes, RecordedQueue] | None = None
        while True:
            await asyncio.sleep(self.cluster.rng.uniform(0, WATCH_SECONDS_MAX))
            try:
                await self.cluster.pass_through(self)
                if seen is None:
                    await self.queues.missed()
            except StampedeError:
                seen = None
                continue
            before, seen = seen, {one.queue_id: one for one in self.cluster.queues()}
            for record in seen.values():
                if before is None or before[record.queue_id] != record:
                    self.queues.changed(record, removed=False)

    def stop_timers(self) -> None:
        """Cancel the timers of all queues, because the host is dead."""
        for hosted in self.queues.all():
            if hosted._timer is not None:
                hosted._timer.cancel()


@lru_cache(maxsize=16)
def _recorded(record: QueueRecord) -> RecordedQueue:
    """The record, as a host reads it. The result is cached, because hosts ask for it several times a second."""
    return recorded_queue(queue_record(record))


class _AnyCaller:
    """The check of the callers of feeds and moves, in a cluster without certificates."""

    async def check(self, context: Any, host_id: bytes) -> None:
        pass


class DirectoryOfQueues:
    """The calls of one host to the directory about queues. Each answer may be lost."""

    def __init__(self, host: QueueHost) -> None:
        self._host = host

    async def _reach(self) -> QueueCluster:
        await self._host.cluster.pass_through(self._host)
        return self._host.cluster

    async def _apply(self, operation: Operation) -> Any:
        result = (await self._reach()).apply(operation)
        await self._reach()
        return result

    async def resolve(self, queue_id: bytes) -> ResolvedQueue:
        cluster = await self._reach()
        record = cluster.queue(queue_id)
        target = cluster.target(record.host_id) or None
        await self._reach()  # the answer may come late, or be lost
        return ResolvedQueue(queue=record, target=target)

    async def queue(self, queue_id: bytes) -> tuple[RecordedQueue, str | None]:
        found = await self.resolve(queue_id)
        return found.queue, found.target

    async def source_of(self, queue_id: bytes, host_id: bytes) -> FeedSource | None:
        cluster = await self._reach()
        record = cluster.queue(queue_id)
        if record.host_id == host_id:
            return FeedSource(host_id, "", record.epoch)
        copy = next((one for one in cluster.copies(queue_id) if one.host_id == host_id), None)
        if copy is None:
            return None
        return FeedSource(copy.source_host_id, cluster.target(copy.source_host_id), record.epoch, True)

    async def replicas_of(self, queue_id: bytes) -> ListedReplicas:
        cluster = await self._reach()
        record = cluster.queue(queue_id)
        return ListedReplicas(record.host_id, record.epoch, [
            ListedReplica(
                KnownReplica(one.host_id, one.boot_incarnation, one.in_sync, one.added_index),
                cluster.target(one.host_id), one.acknowledged,
            )
            for one in cluster.copies(queue_id)
        ])  # fmt: skip

    async def add_replica(self, queue_id: bytes, epoch: int, *, acknowledged: bool) -> None:
        await self._apply(AddReplica(
            channel_id=queue_id, epoch=epoch, kind=ReplicaKind.WARM, acknowledged=acknowledged, is_of_queue=True
        ))  # fmt: skip

    async def remove_replica(self, queue_id: bytes, epoch: int, host_id: bytes) -> None:
        await self._apply(RemoveReplica(channel_id=queue_id, host_id=host_id, epoch=epoch, is_of_queue=True))

    async def change(self, queue_id: bytes, epoch: int, change: ReplicaChange) -> None:
        await self._apply(SetReplicaInSync(
            channel_id=queue_id, epoch=epoch, host_id=change.host_id, boot_incarnation=change.boot_incarnation,
            in_sync=change.in_sync, change_number=change.number, added_index=change.added_index, is_of_queue=True,
        ))  # fmt: skip

    async def commit_queue(self, queue_id: bytes, epoch: int, request_id: bytes, permit: bytes = b"") -> RecordedQueue:
        identity, registered_index = self._host.identity, self._host.registered_index if permit else 0
        cluster = await self._reach()
        if (before := cluster.queue_commits.get(request_id)) is not None:
            return before
        result = cluster.apply(CommitQueueMove(
            queue_id=queue_id, epoch=epoch, to_host_id=identity.host_id,
            to_boot_incarnation=identity.boot_incarnation, to_registered_index=registered_index, permit=permit,
        ))  # fmt: skip
        assert isinstance(result, QueueMoveCommitted)
        record = cluster.queue_commits[request_id] = recorded_queue(queue_record(result.queue))
        await self._reach()
        return record


class QueueCluster(Cluster):
    """The directory, its hosts, and the two queues."""

    host_type = QueueHost

    def __init__(
        self, clock: VirtualClock, seed: int, count: int, policy: Policy, *, lease_nanos: int, max_deliveries: int
    ) -> None:
        """`lease_nanos`, `max_deliveries`: the settings of `jobs`."""
        self.lease_nanos, self.max_deliveries = lease_nanos, max_deliveries
        super().__init__(clock, seed, count, policy)

    def _open(self, policy: Policy) -> None:
        self.queue_commits: dict[bytes, RecordedQueue] = {}
        settings: dict[str, Any] = {"ack": "replica", "replicas": policy.replicas, "min_replicas": policy.min_replicas}
        self.dead_id = self.apply(open_queue("dead", incarnation=500, **settings)).queue.queue_id
        settings |= {"lease_nanos": self.lease_nanos, "max_deliveries": self.max_deliveries}
        settings |= {"dead_letter_queue_id": self.dead_id}
        self.jobs_id = self.apply(open_queue("jobs", incarnation=600, **settings)).queue.queue_id

    def copied(self) -> list[Copied]:
        return [*self.log.directory.tables.queues.by_id.values()]

    def queue(self, queue_id: bytes) -> RecordedQueue:
        """The present record of a queue."""
        return _recorded(self.log.directory.tables.queues.by_id[queue_id])

    def queues(self) -> list[RecordedQueue]:
        """The present records."""
        return [self.queue(one) for one in (self.jobs_id, self.dead_id)]

    def copies(self, queue_id: bytes) -> tuple[ReplicaRecord, ...]:
        """The directory's replicas of a queue."""
        return self.log.directory.tables.replicas.of(queue_id)

    def target(self, host_id: bytes) -> str:
        """The address of a host's gatekeeper; empty if the host is not alive."""
        host = self.log.directory.tables.hosts[host_id]
        return host.name if host.alive else ""

    def owner_of(self, queue_id: bytes) -> QueueHost:
        """The owner. Raises Unavailable if callers do not reach it."""
        host = self.hosts[int.from_bytes(self.queue(queue_id).host_id, "big")]
        assert isinstance(host, QueueHost)
        if not host.alive:
            raise Unavailable("the owner is dead")
        return host

    def kill(self, number: int) -> None:
        host = self.hosts[number]
        super().kill(number)
        assert isinstance(host, QueueHost)
        host.stop_timers()

    async def move(self, queue_id: bytes, number: int) -> None:
        """Move a queue to a host, as a client that may move it does. Raises StampedeError."""
        record, host = self.queue(queue_id), self.hosts[number]
        if not host.alive or record.host_id == id_of(number):
            return
        self.owner_of(queue_id).outgoing.allowed.allow(queue_id, record.epoch, id_of(number))
        await host.arrivals.move_here(record, self.target(record.host_id) or None)


def serving_queue(cluster: QueueCluster, queue_id: bytes) -> list[int]:
    """The numbers of the hosts that serve the queue, at any epoch."""
    found = []
    for number, host in cluster.hosts.items():
        hosted = host.queues.known(queue_id)
        if hosted is None or not host.running.is_set() or not hosted.epoch:
            continue
        try:
            host.queues.find(queue_id, hosted.epoch)
        except StampedeError:
            continue
        found.append(number)
    return found
