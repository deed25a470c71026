"""Keeps the replicas of the queues that one host owns. The rules are the same as in `replica_keeper`."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial

import grpc

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.copies.queues.queue_feed import QueueFeedStream, feed_until_gone
from stampede_rt_channel_host.copies.replica_directory import ListedReplica, ListedReplicas, ReplicaDirectory
from stampede_rt_channel_host.copies.replica_keeper import KeeperTasks, KeptReplicas
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_replication import QueueReplication
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.refusals import display_name

logger = logging.getLogger(__name__)

SILENT_OWNER_SECONDS = 5.0  # if its owner was silent for this time, a copy may be obsolete


class QueueReplicaKeeper(KeeperTasks):
    """Keeps the replicas of the queues of one host."""

    def __init__(
        self, identity: HostIdentity, queues: QueueStore, directory: ReplicaDirectory,
        dial: Callable[[str], grpc.aio.Channel],
    ) -> None:  # fmt: skip
        """`directory`: the directory of queues. `dial` opens connections to other hosts."""
        super().__init__()
        self._identity = identity
        self._queues = queues
        self._directory = directory
        self._dial = dial
        queues.on_replicated = self._begin

    def _begin(self, hosted: HostedQueue) -> None:
        assert hosted.replication is not None, "the store names only queues with replicas"
        kept = _KeptQueue(self._queues, self._directory, self._dial, hosted, hosted.replication, self._identity.host_id)
        self.keep(kept)

    async def drop_unneeded_forever(self) -> None:
        """Ask the directory about copies whose owners are silent. Drop removed copies. Serve the queues whose owner is
        now this host.
        """
        while True:  # paced by the sleep
            await asyncio.sleep(SILENT_OWNER_SECONDS)
            for copy in self._queues.copies.with_silent_owner(SILENT_OWNER_SECONDS):
                queue_id, last_message_nanos = copy.record.queue_id, copy.last_message_nanos
                try:
                    source = await self._directory.source_of(queue_id, self._identity.host_id)
                    if source is None:
                        self._queues.copies.drop_silent(copy, last_message_nanos)
                    elif source.host_id == self._identity.host_id:
                        await self._queues.use(queue_id, None)
                except StampedeError as error:
                    if error.reason == "QUEUE_NOT_FOUND":
                        self._queues.copies.drop(queue_id)


class _KeptQueue(KeptReplicas):
    """Keeps the replicas of one queue, and feeds them."""

    def __init__(
        self, queues: QueueStore, directory: ReplicaDirectory, dial: Callable[[str], grpc.aio.Channel],
        hosted: HostedQueue, replication: QueueReplication, host_id: bytes,
    ) -> None:  # fmt: skip
        super().__init__(host_id, directory, replication, hosted.record.queue_id)
        self._queues = queues
        self._dial = dial
        self._hosted = hosted
        self._targets: dict[bytes, str] = {}
        self._steps = replication

    @property
    def name(self) -> str:
        """The queue's name, for people."""
        return display_name(self._hosted.record)

    @property
    def epoch(self) -> int:
        """The queue's epoch."""
        return self._hosted.epoch

    @property
    def wanted(self) -> int:
        """The number of replicas that the policy asks for."""
        return self._hosted.record.policy.replicas or 0

    def is_served(self) -> bool:
        """Whether this host still has the queue, with these replicas."""
        return self._queues.serves(self._hosted) and self._hosted.replication is self._steps

    def may_serve(self) -> bool:
        """Whether this host has its lease."""
        self._hosted.check_stalled()
        return self._queues.may_serve()

    async def _list(self) -> ListedReplicas:
        listed = await super()._list()
        self._targets = {one.known.host_id: one.target for one in listed.replicas}
        for one in listed.replicas:
            self.start(one)  # immediately: a new owner answers no caller before the other replicas report
        return listed

    def start(self, replica: ListedReplica) -> None:
        """Feed a replica, unless the host feeds it already."""
        host_id = replica.known.host_id
        if replica.target:
            dial = partial(self._dial_host, host_id)
            self.work_for(host_id, partial(feed_until_gone, partial(self._feed, host_id), dial, self.name), "feed of")

    def _dial_host(self, host_id: bytes) -> grpc.aio.Channel:
        return self._dial(self._targets[host_id])

    def _feed(self, host_id: bytes) -> QueueFeedStream | None:
        target = self._targets.get(host_id, "")
        if not target or not self.is_served():
            return None
        now = self._queues.now
        return QueueFeedStream(self._hosted, self._steps, now, self._host_id, host_id, target, self._queues.scheduler)
