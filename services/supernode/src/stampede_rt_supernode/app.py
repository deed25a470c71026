"""The supernode as a process: one copy of the directory, its leases and its services on one port."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import sys
from collections.abc import AsyncIterator, Coroutine, Sequence
from dataclasses import dataclass
from typing import Any

from stampede_rt.administration.options import ADMINISTRATIVE_VERBS
from stampede_rt.errors import StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.v1 import (
    access_service_pb2_grpc,
    directory_service_pb2_grpc,
    membership_service_pb2_grpc,
    quota_service_pb2_grpc,
)
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.garbage import GarbageCollection
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.limits import CONTROL_LIMITS
from stampede_rt_runtime.main import announce, run_service
from stampede_rt_runtime.metrics.serving import serving_metrics
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS
from stampede_rt_supernode.background import background
from stampede_rt_supernode.core.access.queries import access_state, quota_counts_of_callers
from stampede_rt_supernode.joining.copied_folder import OwnAddress
from stampede_rt_supernode.joining.founding import FoundingRecord, misplacement_warning, note_started, read_founding
from stampede_rt_supernode.joining.join_requests import NEWER_RELEASE, ask_to_join
from stampede_rt_supernode.joining.members import Members, why_diverged
from stampede_rt_supernode.joining.preparing import PREPARING, prepare
from stampede_rt_supernode.joining.probe import Probe
from stampede_rt_supernode.metrics import SupernodeMetrics
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication import (
    LibraryMismatch,
    LogUnavailable,
    ReleaseTooOld,
    ReplicatedLog,
    ReplicationStatus,
    StoreDamaged,
    StoreRefused,
    open_replicated_log,
)
from stampede_rt_supernode.servicers.access_servicer import AccessServicer
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.directory_servicer import DirectoryServicer
from stampede_rt_supernode.servicers.lease_keeper import LeaseKeeper
from stampede_rt_supernode.servicers.level_keeper import LevelKeeper
from stampede_rt_supernode.servicers.load_keeper import LoadKeeper
from stampede_rt_supernode.servicers.membership_servicer import MembershipServicer
from stampede_rt_supernode.servicers.own_cluster import OwnCluster
from stampede_rt_supernode.servicers.quota_servicer import QuotaServicer
from stampede_rt_supernode.servicers.record_services import register_record_services
from stampede_rt_supernode.servicers.submission import Submission
from stampede_rt_supernode.servicers.watch import Watches
from stampede_rt_supernode.settings import SupernodeSettings

logger = logging.getLogger(__name__)

HEALTH_SECONDS = 0.1  # how often the supernode looks at its own state
ACCESS_SECONDS = 0.25  # how often the supernode ends the streams of callers that have lost a right
HAND_OVER_SECONDS = 1.2  # the time that a stopping supernode waits until another member leads


async def serve(settings: SupernodeSettings) -> None:
    """Serve until a stop signal. Raises CannotListen or StampedeError if it cannot start."""
    gc.disable()  # `GarbageCollection` below enables it; the load of the state makes no garbage
    credentials = settings.load_credentials(Role.SUPERNODE)
    replica = DirectoryReplica()
    own_cluster = OwnCluster(replica)
    server = _make_server(credentials, own_cluster, reflection=settings.reflection)
    # The server gets its address first, because the log passes the address to the other members.
    address = server.bind(settings.listen, allow_insecure_anywhere=settings.allow_insecure_anywhere)
    founding = settings.founding(address)
    own_cluster.learn(founding.log_cluster_id)
    if wrong := misplacement_warning(founding, address, settings.advertise):
        logger.warning(wrong, extra={"event": "address_misplaced"})
        await OwnAddress(founding.supernode_id, founding.address, 0, credentials).check()
    if settings.data_dir is None and not settings.members:
        logger.info(
            "this supernode is the only one, and keeps the directory in memory; to keep it on disk, prepare a "
            "folder with `stampede supernode init` or `join`, and name this folder with --data-dir",
            extra={"event": "kept_in_memory"},
        )
    async with _open_log(settings, founding, server, credentials, replica) as log:
        parts = _assemble(settings, founding, log, replica, credentials, own_cluster)
        _register(parts, server)
        await server.start()
        work = _work(settings, founding, parts, server, credentials)
        metrics = SupernodeMetrics(log, replica, parts.probe)
        async with (
            GarbageCollection(),
            serving_metrics(settings.metrics_address(), "supernode", server, metrics.collect),
            background(server, *work),
        ):
            # `run` handles stop signals from its begin on. So the ready line comes after it: the reader of the line may
            # send a signal immediately.
            ready = f"stampede supernode {parts.members.self_id} ready on {address}"
            asyncio.get_running_loop().call_soon(announce, ready)
            await server.run(parts.end_streams)


def _make_server(credentials: Dialer, own_cluster: OwnCluster, *, reflection: bool) -> ServiceServer:
    return ServiceServer(
        secret=credentials.secret,
        client_secret=credentials.client_secret,
        tls=credentials.tls,
        limits=CONTROL_LIMITS,
        judge_cluster=own_cluster.judge,
        reflection=reflection,
    )


@dataclass(frozen=True, kw_only=True)
class _Parts:
    """The parts between the log and its callers."""

    log: ReplicatedLog
    replica: DirectoryReplica
    clock: SystemClock
    submission: Submission
    leases: LeaseKeeper
    levels: LevelKeeper
    watches: Watches
    probe: Probe
    members: Members
    own_cluster: OwnCluster
    membership: MembershipServicer

    async def end_streams(self) -> None:
        """End all watches, so that callers use another supernode. Hand the leadership over. Then close the log.

        After the hand-over another member leads without waiting for an election timeout.
        """
        self.watches.close()
        with contextlib.suppress(LogUnavailable):
            await self.log.hand_over(timeout=HAND_OVER_SECONDS)
        self.submission.close()
        await self.log.close()


def _assemble(
    settings: SupernodeSettings,
    founding: FoundingRecord,
    log: ReplicatedLog,
    replica: DirectoryReplica,
    credentials: Dialer,
    own_cluster: OwnCluster,
) -> _Parts:
    clock = SystemClock()
    submission = Submission(log, replica, time_unix_nano=clock.time_unix_nano)
    leases = LeaseKeeper(log, replica, submission, clock=clock, founding_ttl_nanos=settings.lease_ttl_nanos)
    leases.founding_cluster_id = "" if founding.listed or founding.joining else founding.log_cluster_id
    leases.serves_former_cluster, leases.in_memory = founding.takes_over, settings.data_dir is None
    probe = Probe(log, credentials, explain=credentials.explain)
    members = Members(log, replica, probe, advertise=settings.advertise or founding.address, zone=settings.zone)
    return _Parts(
        log=log,
        replica=replica,
        clock=clock,
        submission=submission,
        leases=leases,
        levels=LevelKeeper(log, replica, submission),
        watches=Watches(replica, log),
        probe=probe,
        members=members,
        own_cluster=own_cluster,
        membership=MembershipServicer(log, replica, members, clock, log_cluster_id=founding.log_cluster_id),
    )


def _register(parts: _Parts, server: ServiceServer) -> None:
    replica, clock, calls = parts.replica, parts.clock, DirectoryCalls(parts.replica, parts.submission)
    servicer = DirectoryServicer(
        replica, parts.submission, parts.leases, parts.watches, parts.members, clock, parts.own_cluster, server.access
    )
    directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(servicer, server.grpc)
    loads = LoadKeeper(parts.log, replica, clock=clock)
    register_record_services(server.grpc, calls, loads, parts.leases, parts.watches)
    access = AccessServicer(calls, clock.time_unix_nano)
    access_service_pb2_grpc.add_AccessServiceServicer_to_server(access, server.grpc)
    quota_service_pb2_grpc.add_QuotaServiceServicer_to_server(QuotaServicer(calls), server.grpc)
    membership_service_pb2_grpc.add_MembershipServiceServicer_to_server(parts.membership, server.grpc)
    server.access.draw_from(lambda: replica.read(access_state))
    server.access.accounts.draw_from(lambda: replica.read(quota_counts_of_callers))


@contextlib.asynccontextmanager
async def _open_log(
    settings: SupernodeSettings,
    founding: FoundingRecord,
    server: ServiceServer,
    credentials: Dialer,
    replica: DirectoryReplica,
) -> AsyncIterator[ReplicatedLog]:
    """The log that drives the directory in `replica`. Raises StampedeError if the store is unusable."""
    if credentials.tls is not None:
        credentials.tls.require_name(founding.supernode_id, "--id")
        credentials.tls.require_address(founding.address)
    replication = founding.replication_settings(settings.data_dir)
    try:
        log = await open_replicated_log(replication, replica, credentials, server.grpc)
    except (StoreDamaged, StoreRefused, LibraryMismatch, ReleaseTooOld) as error:
        raise StampedeError(str(error)) from error
    if settings.data_dir is not None and read_founding(settings.data_dir) is not None:
        note_started(settings.data_dir, founding)
    try:
        yield log
    finally:
        await log.close()


def _work(
    settings: SupernodeSettings, founding: FoundingRecord, parts: _Parts, server: ServiceServer, credentials: Dialer
) -> list[Coroutine[Any, Any, None]]:
    """The work that runs as long as the supernode serves."""
    work: list[Coroutine[Any, Any, None]] = [
        parts.leases.run(),
        parts.levels.run(),
        parts.probe.run(),
        _follow_access(server),
        _follow_own_state(server, parts, has_data_folder=settings.data_dir is not None),
        _watch_founding(server, parts, founding),
    ]
    if settings.data_dir is not None:
        boot = parts.members.boot_incarnation
        own_address = OwnAddress(founding.supernode_id, founding.address, boot, credentials)
        work.append(_for_good(own_address.watch(parts.own_cluster.id)))
    if founding.token and settings.data_dir is not None:
        work.append(_for_good(ask_to_join(founding, settings.data_dir, parts.log, credentials, zone=settings.zone)))
    return work


async def _for_good(work: Coroutine[Any, Any, None]) -> None:
    """Do the work, then wait for ever. The end of a task of `_work` would end the service."""
    await work
    await asyncio.Event().wait()


async def _follow_own_state(server: ServiceServer, parts: _Parts, *, has_data_folder: bool) -> None:
    """Act on changes of this supernode's state, in one loop for all of them.

    The loop ends the service if the others refuse this supernode for good. It ends the watches if the state differs
    from that of most members. It makes the health service report SERVING while this supernode can serve, and
    NOT_SERVING otherwise. `has_data_folder`: whether the supernode was started with a data folder.
    """
    serving = is_diverged = False
    while not server.stopping.is_set():
        status = parts.log.status()
        _end_if_refused(status, has_data_folder=has_data_folder)
        if status.diverged_at and not is_diverged:
            is_diverged = True
            _end_watches(parts, status)
        if parts.members.ready() != serving:
            serving = not serving
            await server.set_serving(serving)
        await asyncio.sleep(HEALTH_SECONDS)


def _end_if_refused(status: ReplicationStatus, *, has_data_folder: bool) -> None:
    """End the service if this supernode was removed, has another folder than before, or has too old a release."""
    if status.removed:
        raise StampedeError(
            f"supernode {status.self_id} was removed from the cluster for ever; to come back, empty its folder "
            "and let it join under a new id"
        )
    anew = f"remove it (stampede supernode remove {status.self_id}), empty the folder, and join under a new id"
    if status.has_lost_store:
        here = "another data folder" if has_data_folder else "a data folder, and was started without --data-dir now"
        raise StampedeError(
            f"supernode {status.self_id} has taken part before with {here}. The former folder holds its votes and "
            f"entries: start it with --data-dir and that folder, or, if the folder is lost, {anew}"
        )
    if status.release_refusal:
        raise StampedeError(f"supernode {status.release_refusal}; {NEWER_RELEASE}")
    if status.has_old_store:
        raise StampedeError(
            f"supernode {status.self_id} has reported entries or a term that its data folder lacks. The folder is "
            f"older, for example because a backup of the disk was restored: use the latest data folder, or {anew}"
        )


def _end_watches(parts: _Parts, status: ReplicationStatus) -> None:
    """End all watches, because this state differs from the state of most members, and log the reason.

    The log continues to run. This member still takes part in it, and counts for its majorities.
    """
    parts.watches.close()
    logger.error(
        "%s; it no longer serves callers: remove it (stampede supernode remove %s), empty its folder, and let it "
        "join under a new id",
        *(why_diverged(status), parts.members.self_id),
        extra={"event": "state_diverged"},
    )


async def _watch_founding(server: ServiceServer, parts: _Parts, founding: FoundingRecord) -> None:
    """End the service if another founder was started with another list of members. Watch until the cluster exists."""
    while founding.listed and not server.stopping.is_set():
        if parts.replica.read(lambda directory: directory.tenure > 0):
            break  # the cluster is founded, and its members themselves refuse later members with another list
        if other := parts.log.status().other_cluster:
            raise StampedeError(
                f"supernode {founding.supernode_id} founds no cluster with --members {', '.join(founding.members)}: "
                f"one of them was given another list, or is of another cluster ({other}); start each of them with the "
                "same --members"
            )
        await asyncio.sleep(HEALTH_SECONDS)
    await asyncio.Event().wait()


async def _follow_access(server: ServiceServer) -> None:
    """End the streams of callers that lose a right, even while no calls come."""
    while not server.stopping.is_set():
        server.access.refresh()
        await asyncio.sleep(ACCESS_SECONDS)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a supernode, or prepare the folder of one. Returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words and words[0] in PREPARING:
        return prepare(words)
    if words and not words[0].startswith("-"):
        sys.stderr.write(f"stampede supernode: {escaped(_not_a_verb(words[0]))}\n")
        return EXIT_BAD_SETTINGS
    return run_service(SupernodeSettings, "supernode", argv, serve)


def _not_a_verb(word: str) -> str:
    if word in ADMINISTRATIVE_VERBS:
        return f"this program has no verb {word!r}; the client has it: stampede supernode {word}"
    verbs = ", ".join((*PREPARING, *ADMINISTRATIVE_VERBS))
    return f"there is no verb {word!r}; the verbs are {verbs}; flags without a verb start a supernode"
