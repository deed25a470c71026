"""A whole channel host: its services, its channels and queues, its registration at the directory.

It runs as a service of its own, or inside another process on that process's event loop.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import grpc

from stampede_rt.v1 import directory_service_pb2, gatekeeper_service_pb2_grpc, migration_service_pb2_grpc
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.host_archive import CLOSE_SECONDS_MAX
from stampede_rt_channel_host.archive.objects.object_archive import ObjectSettings
from stampede_rt_channel_host.archive_setup import set_up_archive
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.channel_changes import ChannelChanges
from stampede_rt_channel_host.channels.channel_servicer import ChannelServicer
from stampede_rt_channel_host.channels.gatekeeper import GatekeeperServicer
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.cluster.access_watch import AccessWatch
from stampede_rt_channel_host.cluster.directory import DirectoryQueries
from stampede_rt_channel_host.cluster.directory_watch import watch_forever
from stampede_rt_channel_host.cluster.identity import HomeCluster, HostIdentity
from stampede_rt_channel_host.cluster.lease_thread import LeaseThread, ServingLoop
from stampede_rt_channel_host.cluster.load_meter import LoadMeter
from stampede_rt_channel_host.cluster.queue_directory import QueueDirectory
from stampede_rt_channel_host.cluster.records import recorded_channel, recorded_queue
from stampede_rt_channel_host.cluster.registration import START_SECONDS_MAX, Registration
from stampede_rt_channel_host.cluster.supernodes import Explain, Supernodes
from stampede_rt_channel_host.copies.feed_callers import FeedCallers
from stampede_rt_channel_host.copies.keeper import CopyKeeper
from stampede_rt_channel_host.copies.moves.draining import HostDrain
from stampede_rt_channel_host.copies.moves.incoming_moves import IncomingMoves
from stampede_rt_channel_host.copies.moves.migration_servicer import MigrationServicer
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMoves
from stampede_rt_channel_host.copies.queues.queue_arrivals import QueueArrivals
from stampede_rt_channel_host.copies.queues.queue_feed_servicer import QueueFeeds
from stampede_rt_channel_host.copies.queues.queue_handover import QueueHandovers
from stampede_rt_channel_host.copies.queues.queue_replica_keeper import QueueReplicaKeeper
from stampede_rt_channel_host.copies.replica_directory import ReplicaDirectory
from stampede_rt_channel_host.copies.replica_keeper import ReplicaKeeper
from stampede_rt_channel_host.copies.replica_servicer import ReplicaServicer
from stampede_rt_channel_host.groups.copied_groups import CopiedGroups
from stampede_rt_channel_host.groups.group_directory import GroupDirectory
from stampede_rt_channel_host.groups.group_servicer import GroupServicer
from stampede_rt_channel_host.groups.reading import GroupReads
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.metrics.host_metrics import HostMetrics
from stampede_rt_channel_host.queues.dead_letters import DeadLetterMover
from stampede_rt_channel_host.queues.queue_servicer import QueueServicer
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.sweep import sweep_queues_forever
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.dial import Dial, naming_cluster
from stampede_rt_runtime.overload import RefusedCalls
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.sockets.tickets import SocketTickets

logger = logging.getLogger(__name__)

# A host that stops keeps its lease this much longer, for its archive. The server gives `leave` 2 s in all.
FINISH_SECONDS_MAX = 1.0
CHANNELS_LISTED_MAX = QUEUES_LISTED_MAX = 1000  # the most channels and the most queues in the answer to a registration


def _set_up_for_host(access: AccessControl, memory_bytes_max: int) -> AccessControl:
    """Set the control up for the callers of a host. Returns the control."""
    access.takes_ids = True
    access.accounts.set_default(Quota.BYTES_HELD, memory_bytes_max * 7 // 8)
    return access


class ChannelHost:
    """Order of use, on one event loop: make it, `add_to` a server, `enter` once that server listens, `leave`.

    `dial` opens connections for that loop, and `dial_streams` opens the connections of feeds; None: `dial`.
    `dial_for_lease` opens the connections of the lease, which has a thread of its own. `access` judges the callers of
    the server; the host gives it the directory's rules. `tickets` are the tickets of the server's sockets.
    `refused_calls` counts the calls that the server refuses. `on_serving` gets True when the host starts to serve, and
    False when it stops. If a task of the host fails, `on_defect` gets the error, and must end the host. `explain`: see
    `Supernodes`. `home` is the cluster of the host. `copy_bytes_per_second`: the most that each copy at this host takes
    from its source; 0: without a limit. `archive`: the folder for recorded channels, open. `objects`: the object store
    to which closed files of recorded channels move; None: they stay in the folder.
    """

    _entering: asyncio.Future[None] | None = None
    _keeping: asyncio.Task[None] | None = None  # the task that keeps the lease

    def __init__(
        self,
        identity: HostIdentity,
        *,
        frontends: Sequence[str],
        dial: Dial,
        dial_for_lease: Dial,
        clock: HostClock,
        memory_bytes_max: int,
        on_serving: Callable[[bool], None],
        on_defect: Callable[[BaseException], None],
        dial_streams: Dial | None = None,
        explain: Explain | None = None,
        home: HomeCluster | None = None,
        access: AccessControl | None = None,
        tickets: SocketTickets | None = None,
        refused_calls: RefusedCalls | None = None,
        copy_bytes_per_second: int = 0,
        archive: ArchiveFolder | None = None,
        objects: ObjectSettings | None = None,
    ) -> None:
        self.identity = identity
        self._home = home or HomeCluster()
        self._dial, self._dial_streams = self._naming(dial), self._naming(dial_streams or dial)
        known: dict[str, Any] = {"peer_name": identity.name, "zone": identity.zone, "explain": explain}
        self._supernodes = Supernodes(frontends, self._dial, **known)
        self._lease_calls = Supernodes(frontends, self._naming(dial_for_lease), **known)
        self._lease = LeaseThread(lambda serving: self._make_registration(self._lease_calls, clock, serving))
        access = _set_up_for_host(access or AccessControl(), memory_bytes_max)
        memory = MemoryBudget(memory_bytes_max, lambda: self.store.sweep.reclaim(), accounts=access.accounts)
        queries = DirectoryQueries(self._supernodes)
        held = self._lease.lease_held
        self.store = ChannelStore(identity, queries, clock, lease_held=held, memory=memory, refused_calls=refused_calls)
        set_up_archive(self.store.recordings, archive, objects, access.accounts, self.store.now)
        self.queues, self._dead_letters = self._make_queues(memory, on_defect)
        self.groups = GroupStore(
            identity, self.store, GroupDirectory(self._supernodes), self._dial, lambda: self._lease_calls.cluster_id
        )
        self._access = AccessWatch(self._supernodes, access)
        self.changes, self._streams = ChannelChanges(self.store, queries), OpenStreams()
        self._gatekeeper = GatekeeperServicer(self.store, self.changes, identity, access, tickets)
        self._make_moves(copy_bytes_per_second)
        self._on_serving, self._on_defect = on_serving, on_defect
        self._tasks: list[asyncio.Task[None]] = []

    def _naming(self, dial: Dial) -> Dial:
        """A `Dial` whose calls name the cluster of this host."""
        return naming_cluster(dial, lambda: self._home.cluster_id or self._lease_calls.cluster_id)

    def _make_registration(self, supernodes: Supernodes, clock: HostClock, serving: ServingLoop) -> Registration:
        """Make the registration. It passes changes of the lease to the serving loop, which handles them in order."""

        async def registered(response: directory_service_pb2.RegisterHostResponse) -> None:
            await serving.run(lambda: self._registered(response))

        return Registration(
            self.identity,
            supernodes,
            clock,
            on_registered=registered,
            on_lease=lambda held: serving.run_soon(lambda: self._lease_changed(held)),
            has_hung=serving.has_hung,
            home=self._home,
            measure_load=LoadMeter(
                lambda: self.store.memory.used_bytes,
                self.store.memory.bytes_max,
                has_archive=self.store.recordings.archive is not None,
                is_private=self.identity.is_private,
            ).measure,
        )

    def _make_moves(self, bytes_per_second: int) -> None:
        """Make the parts for replicas and moves of channels, which use the parts for copies and groups."""
        directory = ReplicaDirectory(self._supernodes)
        self.copies = CopyKeeper(self.identity, self.store, directory, self._dial_streams, bytes_per_second)
        self.replicas = ReplicaKeeper(self.identity, self.store, directory, self._dial)
        queue_directory = ReplicaDirectory(self._supernodes, of_queues=True)
        self.replicas_of_queues = QueueReplicaKeeper(self.identity, self.queues, queue_directory, self._dial_streams)
        self._move_directory = MoveDirectory(self._supernodes, self.identity)
        self.moves_away = OutgoingMoves(self.identity, self.store, self._move_directory, self.copies)
        self.moves_here = IncomingMoves(
            self.identity, self.store, self._move_directory, self.copies, self._dial_streams, bytes_per_second
        )
        self._queues_here = QueueArrivals(self.identity, self.queues, self._move_directory, self._dial)
        self.store.copies.on_inherited = self.groups.exchange.inherit_floors
        self.draining = HostDrain(
            self.store, self.queues, self._move_directory, self.groups.ids_of, self._dial, self._dial_streams,
            self.moves_away.allowed.allow,
        )  # fmt: skip
        self._callers = FeedCallers(DirectoryQueries(self._supernodes))
        self._migration = MigrationServicer(
            self.moves_here,
            self._queues_here,
            QueueHandovers(self.identity, self.queues, self._move_directory, self.moves_away, self._callers),
            self._move_directory,
            self.draining,
            QueueFeeds(self.identity, self.queues, queue_directory, self._callers),
            self.identity,
            self.moves_away.allowed.allow,
            self._streams,
        )

    def _make_queues(
        self, memory: MemoryBudget, on_defect: Callable[[BaseException], None]
    ) -> tuple[QueueStore, DeadLetterMover]:
        """The queues, and the mover of their dead letters. Each of the two needs the other."""
        directory = QueueDirectory(self._supernodes)
        queues = QueueStore(
            self.identity,
            directory,
            memory,
            now=self.store.now,
            lease_held=self._lease.lease_held,
            scheduler=self.store.scheduler,
            on_dead_letters=lambda hosted: mover.new_dead_letters(hosted),
        )
        mover = DeadLetterMover(directory, self._dial, may_move=queues.holds, on_defect=on_defect)
        return queues, mover

    def metrics(self, names: str) -> HostMetrics:
        """The host's metrics. `names`: the pattern of the channels, queues and groups with metrics of their own."""
        return HostMetrics(self.store, self.queues, self.groups, self._lease, names=names)

    def add_to(self, server: grpc.aio.Server) -> None:
        """Serve the gatekeeper and the data services on `server`."""
        gatekeeper_service_pb2_grpc.add_GatekeeperServiceServicer_to_server(self._gatekeeper, server)
        ChannelServicer(
            self.store, GroupReads(self.groups, CopiedGroups(GroupDirectory(self._supernodes))), self._streams
        ).add_to(server)
        GroupServicer(self.groups, self._dial, self._streams).add_to(server)
        QueueServicer(self.queues, self._streams).add_to(server)
        ReplicaServicer(self.store, self._streams, self.groups.floors_of, self.moves_away, self._callers).add_to(server)
        # one servicer for gRPC and sockets: a queue's newest feed ends an earlier feed, also over the other transport
        migration_service_pb2_grpc.add_MigrationServiceServicer_to_server(self._migration, server)

    async def enter(
        self, target: str, timeout_s: float = START_SECONDS_MAX, *, local_target: str = "", tcp_target: str = ""
    ) -> None:
        """Register the host under the address `target`, and keep the lease from then on.

        `local_target` and `tcp_target`: the Unix socket and the TCP port at which the host serves streams, "unix:PATH"
        and "tcp:PORT"; empty: there is none.

        Waits until the directory knows the host. Raises the directory's refusal, or after `timeout_s` the last failure.
        """
        self._gatekeeper.target, self._gatekeeper.local_target = target, local_target
        self._gatekeeper.tcp_target = tcp_target
        self.copies.target = target
        self.store.rings.fence_boottime = self._lease.fence_boottime
        self._entering = asyncio.ensure_future(self._lease.enter(target, timeout_s))
        await self._entering
        self._supernodes.learn(self._lease_calls.known())  # the front-ends may be gone before the next request
        self._keeping = self._start(self._lease.keep(), "lease")
        self.store.recordings.start()
        self._start(self.store.sweep.run_forever(), "sweep")
        self._start(self.groups.keep(), "groups")
        self._start(self.copies.report_forever(), "copies")
        groups_watch = directory_service_pb2.WatchRequest(include_groups=True)
        self._start(watch_forever(self._supernodes, groups_watch, self.groups), "group watch")
        self._start(self._access.keep(), "access")
        access_watch = directory_service_pb2.WatchRequest(name_glob="-", include_access=True)  # matches no channel
        self._start(watch_forever(self._supernodes, access_watch, self._access), "access watch")
        self._start(sweep_queues_forever(self.queues), "queue sweep")
        self._start(self.replicas_of_queues.drop_unneeded_forever(), "replicas of queues")
        queues_watch = directory_service_pb2.WatchRequest(include_queues=True)
        self._start(watch_forever(self._supernodes, queues_watch, self.queues), "queue watch")

    async def give_away(self, seconds: float) -> None:
        """Move the channels and queues to other hosts, and accept none from other hosts, because this host stops.

        Then brings the archive to its object store. All this takes `seconds` at most.
        """
        ends_s = time.monotonic() + seconds
        self.moves_here.close()
        self._queues_here.close()
        await self.draining.run(seconds, arrivals=(self.moves_here.ended, self._queues_here.ended))
        await self._finish_archive(ends_s - time.monotonic())

    async def _finish_archive(self, seconds_max: float) -> None:
        """Bring the archive to its object store while this host has its lease, so that the next owners find all of it.

        Refuses all requests for channels from then on, if there is an object store.
        """
        if self.store.recordings.has_object_store and seconds_max > 0:
            self.store.close()
            await self.store.recordings.finish(self._boot_if_entered, min(seconds_max, CLOSE_SECONDS_MAX))

    @property
    def _boot_if_entered(self) -> int:
        """The boot incarnation of this process; 0: it has never registered."""
        return self.identity.boot_incarnation if self._tasks else 0

    async def leave(self) -> None:
        """Refuse new requests, and deregister the host. Then end all waits and streams. Cancels a running `enter`.

        With an object store, brings the archive there first, for FINISH_SECONDS_MAX at most.
        """
        for task in self._tasks:
            if task is not self._keeping:
                task.cancel()
        if self._entering is not None and not self._entering.done():
            self._entering.cancel()
        self.store.close()
        self.queues.close()
        self._dead_letters.close()
        await self._finish_archive(FINISH_SECONDS_MAX)
        if self._keeping is not None:
            self._keeping.cancel()
        await self._lease.leave()
        self.groups.end_all(refusals.SHUTTING_DOWN)
        self.store.end_all(refusals.SHUTTING_DOWN)
        self.queues.end_all(refusals.SHUTTING_DOWN)
        await self.replicas_of_queues.aclose()
        for part in (self.groups, self.replicas, self.copies, self.moves_here, self._queues_here, self.moves_away):
            await part.aclose()
        await self._streams.end_all(refusals.SHUTTING_DOWN)
        if self.store.multicasts is not None:
            self.store.multicasts.close()
        await self.store.recordings.close(self._boot_if_entered)
        await self._supernodes.aclose()

    def _start(self, work: Coroutine[Any, Any, None], name: str) -> asyncio.Task[None]:
        task = asyncio.create_task(work, name=name)
        task.add_done_callback(self._check)
        self._tasks.append(task)
        return task

    def _check(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (failure := task.exception()) is not None:
            logger.error(
                "a task of the host ended with a defect",
                exc_info=failure,
                extra={"event": "task_defect", "task": task.get_name()},
            )
            self._on_defect(failure)

    async def _registered(self, response: directory_service_pb2.RegisterHostResponse) -> None:
        self._move_directory.registered_index = response.registered_index
        channels, queues, scheduler = response.channels, response.queues, self.store.scheduler
        self.store.recordings.own({one.channel_id: one.epoch for one in channels})
        await scheduler.do(
            self.store.registering(map(recorded_channel, channels), is_complete=len(channels) < CHANNELS_LISTED_MAX)
        )
        await scheduler.do(
            self.queues.registering(map(recorded_queue, queues), is_complete=len(queues) < QUEUES_LISTED_MAX)
        )

    def _lease_changed(self, held: bool) -> None:
        if not held:
            self.store.fence()
            self.groups.fence()
            self.queues.fence()
        self._on_serving(held)
