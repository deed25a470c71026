"""The owner's side of replicas: adds missing ones, and tells the directory which of them are in sync."""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from typing import Any

import grpc

from stampede_rt.errors import (
    ChannelNotFound,
    HostNotFound,
    InvalidArgument,
    QueueNotFound,
    StaleBinding,
    StampedeError,
    Unavailable,
)
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import gatekeeper_service_pb2, gatekeeper_service_pb2_grpc
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.owned_replicas import OwnedReplicas
from stampede_rt_channel_host.channels.replication import ReplicationKind
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.copies.replica_directory import ListedReplica, ListedReplicas, ReplicaDirectory
from stampede_rt_channel_host.core.replication import ReplicaState
from stampede_rt_runtime.error_frames import drop_frames, failure_of

logger = logging.getLogger(__name__)

ROUND_SECONDS = 0.2  # a replica that is silent for a second loses its flag at most this time later
MISSING_SECONDS, LIST_SECONDS = 1.0, 10.0  # how old the list of the directory may be, with replicas missing and without
# MISSING_SECONDS doubles with each try that adds no replica, up to LIST_SECONDS: each try is an entry of the log.
PAUSE_SECONDS = 0.02
BIND_SECONDS_MAX = 2.0


class KeptReplicas(ABC):
    """Keeps the replicas of one channel or queue.

    One task makes all requests to the directory, one after the other. Its list of replicas therefore always includes
    the last change that it made.
    """

    def __init__(
        self, host_id: bytes, directory: ReplicaDirectory, replication: OwnedReplicas[Any], subject_id: bytes
    ) -> None:
        """`subject_id`: the id of the channel or queue."""
        self._host_id = host_id
        self._directory = directory
        self._replication = replication
        self._subject_id = subject_id
        self._listed_s, self._listed_epoch = -LIST_SECONDS, 0
        self._lacks_replicas = True
        self._missing_s = MISSING_SECONDS
        self._has_reported = False
        self._work: dict[bytes, asyncio.Task[None]] = {}  # by the host of a replica

    @property
    @abstractmethod
    def name(self) -> str:
        """The name, for people."""

    @property
    @abstractmethod
    def epoch(self) -> int:
        """The epoch at which this host is the owner."""

    @property
    @abstractmethod
    def wanted(self) -> int:
        """The number of replicas that the policy asks for."""

    @property
    def waits(self) -> bool:
        """Whether the owner answers its callers only after the replicas have their changes."""
        return True

    @abstractmethod
    def is_served(self) -> bool:
        """Whether this host is the owner, as far as it knows."""

    @abstractmethod
    def may_serve(self) -> bool:
        """Whether this host has its lease."""

    @abstractmethod
    def start(self, replica: ListedReplica) -> None:
        """Begin a replica that has no feed, in the background."""

    async def run(self) -> None:
        """Keep the replicas until the host gives the channel or queue up."""
        try:
            while self.is_served():  # paced by the wait for a change
                await self.look()
                with suppress(TimeoutError):
                    async with asyncio.timeout(ROUND_SECONDS):
                        await self._replication.keeper_wakeup.wait()
                await asyncio.sleep(PAUSE_SECONDS)  # a change comes with each report of a replica that is out of sync
                self._replication.keeper_wakeup.clear()
        except (ChannelNotFound, QueueNotFound):
            return
        finally:
            for task in [*self._work.values()]:
                task.cancel()

    async def look(self) -> None:
        """Do what is due now. Raises ChannelNotFound and QueueNotFound; logs other errors."""
        try:
            if self.may_serve():
                await self._round()
        except (ChannelNotFound, QueueNotFound):
            raise
        except StampedeError as error:
            self._listed_s = -LIST_SECONDS
            self._log_failure(error)

    def work_for(self, host_id: bytes, work: Callable[[], Coroutine[Any, Any, None]], what: str) -> None:
        """Do `work` for the replica at a host in the background, unless earlier work for it is still running.

        The task that reports the flags of all replicas does not wait for this work, because the host may be frozen.
        """
        if host_id not in self._work:
            task = self._work[host_id] = asyncio.create_task(work(), name=f"{what} {self.name}")
            task.add_done_callback(partial(self._work_ended, host_id))

    def _work_ended(self, host_id: bytes, task: asyncio.Task[None]) -> None:
        self._work.pop(host_id, None)
        _log_defect(task)

    async def _round(self) -> None:
        now_s = asyncio.get_running_loop().time()
        age_s = now_s - self._listed_s
        is_old = age_s >= (self._missing_s if self._lacks_replicas else LIST_SECONDS)
        # A new epoch of the same owner clears flags, too.
        if is_old or self._listed_epoch != self.epoch or not self._replication.is_known:
            listed = await self._list()
            if listed.owner_host_id != self._host_id or listed.epoch != self.epoch:
                return  # the store learns of the new owner from its next caller, or from its next registration
            self._listed_s, self._listed_epoch = now_s, listed.epoch
            await self._make_complete(listed)
        for change in self._replication.changes():
            try:
                await self._directory.change(self._subject_id, self.epoch, change)
            except (HostNotFound, InvalidArgument):  # the replica is gone, or has begun anew
                self._listed_s = -LIST_SECONDS
                continue
            self._replication.confirm(change)
            self._note(change.in_sync, change.host_id)
        wanted = self.wanted
        in_sync = sum(state is ReplicaState.IN for state in self._replication.states().values())
        if in_sync == wanted:
            self._has_reported = False
        self._lacks_replicas = in_sync != wanted or len(self._replication.states()) != wanted

    async def _list(self) -> ListedReplicas:
        """The directory's replicas. Removes replicas of the other kind.

        A caller may have added such a replica before the owner knows that the directory has changed the policy. The
        directory then believes, for example, that puts wait for the replica, although they do not. Such a replica would
        become the owner under the same incarnation although items are lost.
        """
        listed = await self._directory.replicas_of(self._subject_id)
        if listed.owner_host_id == self._host_id and listed.epoch == self.epoch:
            others = [one for one in listed.replicas if one.acknowledged is not self.waits]
            await self._remove(others, listed.epoch)
            listed = listed._replace(replicas=[one for one in listed.replicas if one not in others])
            self._replication.know([one.known for one in listed.replicas])
        return listed

    async def _make_complete(self, listed: ListedReplicas) -> None:
        """Add missing replicas, remove surplus ones, and begin the replicas that have no feed."""
        wanted, replicas = self.wanted, listed.replicas
        failure: StampedeError | None = None
        missing_s, self._missing_s = self._missing_s, MISSING_SECONDS
        if len(replicas) < wanted:
            try:
                for _ in range(wanted - len(replicas)):
                    await self._directory.add_replica(self._subject_id, self.epoch, acknowledged=self.waits)
            except (Unavailable, InvalidArgument) as error:  # no host is left, or this host does not know the policy
                failure, self._missing_s = error, min(2 * missing_s, LIST_SECONDS)
            replicas = (await self._list()).replicas
        for one in await self._without_surplus(replicas, listed.epoch):
            if one.target and not self._replication.is_fed(one.known.host_id):
                self.start(one)
        if failure is not None:
            self._log_failure(failure)

    async def _without_surplus(self, replicas: list[ListedReplica], epoch: int) -> list[ListedReplica]:
        """Remove the replicas that are too many. Returns the others."""
        surplus = sorted(replicas, key=lambda one: one.known.in_sync)[: max(0, len(replicas) - self.wanted)]
        if not surplus:
            return replicas
        await self._remove(surplus, epoch)
        left = [one for one in replicas if one not in surplus]
        self._replication.know([one.known for one in left])
        return left

    async def _remove(self, replicas: list[ListedReplica], epoch: int) -> None:
        """Remove replicas that were listed at `epoch`. Raises StaleBinding if the channel or queue has another one."""
        for one in replicas:
            await self._directory.remove_replica(self._subject_id, epoch, one.known.host_id)
            self._listed_s = -LIST_SECONDS

    def _log_failure(self, error: StampedeError) -> None:
        """Log a failure, once until the next success."""
        if not self._has_reported:
            self._has_reported = True
            logger.warning(
                "the replicas of a channel or queue are incomplete; the host tries again",
                extra={"event": "replicas_incomplete", "channel": self.name, "why": str(error)},
            )

    def _note(self, in_sync: bool, host_id: bytes) -> None:
        facts = {"channel": self.name, "host_id": host_id.hex()}
        if in_sync:
            logger.info("a replica is in sync", extra={"event": "replica_in_sync"} | facts)
        else:
            logger.info("a replica is out of sync", extra={"event": "replica_out_of_sync"} | facts)


class KeeperTasks:
    """A task for each channel or queue whose replicas this host keeps."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def keep(self, kept: KeptReplicas) -> None:
        """Keep the replicas of one channel or queue from now on."""
        task = asyncio.create_task(kept.run(), name=f"replicas of {kept.name}")
        self._tasks.add(task)
        task.add_done_callback(self._check)

    async def aclose(self) -> None:
        """End all tasks."""
        tasks = [*self._tasks]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _check(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        _log_defect(task)


def _log_defect(task: asyncio.Task[None]) -> None:
    failure = failure_of(task)  # also drops the frames of a cancelled task, which keep the task, and a whole queue
    if failure is not None:
        extra = {"event": "task_defect", "task": task.get_name()}
        logger.error("the keeper of replicas has ended with a defect", exc_info=failure, extra=extra)
        drop_frames(failure)


class ReplicaKeeper(KeeperTasks):
    """Keeps the replicas of the channels that one host owns."""

    def __init__(
        self, identity: HostIdentity, store: ChannelStore, directory: ReplicaDirectory,
        dial: Callable[[str], grpc.aio.Channel],
    ) -> None:  # fmt: skip
        """`dial` opens connections to other hosts."""
        super().__init__()
        host_id = identity.host_id
        store.on_replicated = lambda hosted: self.keep(KeptChannel(host_id, store, directory, dial, hosted))


class KeptChannel(KeptReplicas):
    """Keeps the replicas of one channel."""

    def __init__(
        self, host_id: bytes, store: ChannelStore, directory: ReplicaDirectory,
        dial: Callable[[str], grpc.aio.Channel], hosted: HostedChannel,
    ) -> None:  # fmt: skip
        assert hosted.replication is not None, "the store names only channels with replicas"
        super().__init__(host_id, directory, hosted.replication, hosted.record.channel_id)
        self._store = store
        self._dial = dial
        self._hosted = hosted

    @property
    def waits(self) -> bool:
        """Whether puts wait for the replicas."""
        return self._hosted.kind_of_replicas is ReplicationKind.WAITED_FOR

    @property
    def name(self) -> str:
        """The channel's name."""
        return self._hosted.record.name

    @property
    def epoch(self) -> int:
        """The channel's epoch."""
        return self._hosted.epoch

    @property
    def wanted(self) -> int:
        """The number of replicas that the policy asks for."""
        return self._hosted.record.policy.replicas or 0

    def is_served(self) -> bool:
        """Whether this host has the channel."""
        return self._store.serves(self._hosted)

    def may_serve(self) -> bool:
        """Whether this host has its lease."""
        return self._store.lease_held()

    def start(self, replica: ListedReplica) -> None:
        """Have the host of a replica begin it."""
        self.work_for(replica.known.host_id, partial(self._start, replica), "start of a replica of")

    async def _start(self, replica: ListedReplica) -> None:
        """Bind the channel at the host of a replica. That host answers MOVED, because a replica serves no readers."""
        channel = self._dial(replica.target)
        stub = gatekeeper_service_pb2_grpc.GatekeeperServiceStub(channel)
        request = gatekeeper_service_pb2.BindChannelRequest(channel_id=self._subject_id, epoch=self._hosted.epoch)
        try:
            await stub.BindChannel(request, timeout=BIND_SECONDS_MAX)
        except grpc.RpcError as error:
            if not isinstance(from_rpc_error(error, replica.target), StaleBinding):
                self._log_failure(from_rpc_error(error, replica.target))
        finally:
            await channel.close(None)
