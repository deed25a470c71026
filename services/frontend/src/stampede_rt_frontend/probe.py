"""Asks every supernode each second whether it can serve and who the members are. Measures the round trips."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from itertools import islice
from time import perf_counter_ns, time_ns

import grpc

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import directory_service_pb2, directory_service_pb2_grpc
from stampede_rt.values.peering import ClockOffset
from stampede_rt_frontend.access_follower import AccessFollower
from stampede_rt_frontend.ranking import Supernode
from stampede_rt_frontend.roster import MemberList, ProbeAnswer, SupernodeRoster
from stampede_rt_frontend.status_log import StatusLog
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.dial import naming_cluster

logger = logging.getLogger(__name__)

PROBE_DEADLINE_SECONDS = 1.0
PROBE_PERIOD_SECONDS = 1.0
WOKEN_PER_TURN = 16
"""The most waiting callers that the front-end wakes in one turn of the event loop."""
_RETRY_SECONDS_MIN = 0.05
"""Half the first pause after a failed probe. Each further failure doubles the pause, up to PROBE_PERIOD_SECONDS."""


class Prober:
    """Keeps a roster up to date, with one task and one connection per supernode. Use it as an async context manager.

    `explain` may give a better reason than gRPC for a failed connection to a supernode. `access` gets the state of
    access, such as the keys of client tokens.
    """

    def __init__(
        self,
        roster: SupernodeRoster,
        dial: Callable[[str], grpc.aio.Channel],
        *,
        explain: Callable[[str], Awaitable[StampedeError | None]] | None = None,
        access: AccessControl | None = None,
    ) -> None:
        self._roster = roster
        self._explain = explain
        self._dial = naming_cluster(dial, lambda: roster.cluster_id)
        self._access = AccessFollower(access or AccessControl())
        self._tasks: dict[str, asyncio.Task[None]] = {}
        # target -> the id of another cluster, to which the supernode at that target belonged at its last answer
        self._foreign: dict[str, str] = {}
        # callers that wait for a supernode that can serve
        self._waiting: dict[asyncio.Future[None], None] = {}
        self._status_log = StatusLog()

    async def __aenter__(self) -> Prober:
        self._match_tasks()
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        tasks = list(self._tasks.values())
        self._tasks.clear()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def wait_healthy(self, timeout: float) -> bool:
        """Wait until a supernode can serve, for `timeout` seconds at most. Returns False if none can."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout):
                while not self._roster.any_healthy():
                    healthy = asyncio.get_running_loop().create_future()
                    self._waiting[healthy] = None
                    try:
                        await healthy
                    finally:
                        self._waiting.pop(healthy, None)
        return self._roster.any_healthy()

    @property
    def waiting(self) -> int:
        """The number of callers that wait for a supernode that can serve."""
        return len(self._waiting)

    def _wake_some(self) -> None:
        """Wake some of the callers, the longest waiting first, because a supernode can serve.

        The next turns of the event loop wake the others.
        """
        for healthy in [*islice(self._waiting, WOKEN_PER_TURN)]:
            del self._waiting[healthy]
            if not healthy.done():  # done: the timeout of this caller has ended its wait
                healthy.set_result(None)
        if self._waiting:
            asyncio.get_running_loop().call_soon(self._wake_some)

    def _match_tasks(self) -> None:
        """Start a task for each new target of the roster, and cancel the tasks of targets that have left the roster."""
        targets = set(self._roster.targets())
        for target in targets - self._tasks.keys():
            task = asyncio.create_task(self._watch(target), name=f"probe {target}")
            task.add_done_callback(_log_defect)
            self._tasks[target] = task
        for target in self._tasks.keys() - targets:
            self._tasks.pop(target).cancel()

    async def _watch(self, target: str) -> None:
        async with self._dial(target) as channel:
            stub = directory_service_pb2_grpc.DirectoryServiceStub(channel)
            pause = _RETRY_SECONDS_MIN
            while True:  # until the target leaves the roster, when `_match_tasks` cancels this task
                healthy = await self._probe(target, channel, stub)
                self._log_changes()
                if self._roster.any_healthy():
                    self._wake_some()
                pause = PROBE_PERIOD_SECONDS if healthy else min(2 * pause, PROBE_PERIOD_SECONDS)
                await asyncio.sleep(pause)
                pause = _RETRY_SECONDS_MIN if healthy else pause

    async def _probe(
        self, target: str, channel: grpc.aio.Channel, stub: directory_service_pb2_grpc.DirectoryServiceAsyncStub
    ) -> bool:
        """Probe once. Returns True if the supernode can serve."""
        try:
            answer = await _ping(channel, stub)
            accepted = self._roster.note_answer(target, answer)
            if not accepted and self._foreign.get(target) != answer.cluster_id:
                self._foreign[target] = answer.cluster_id
                logger.warning(
                    "another cluster's supernode",
                    extra={"event": "other_cluster_supernode", "target": target, "cluster_id": answer.cluster_id},
                )
            if answer.ready and accepted:
                self._roster.update_members(await _list(stub))
                await self._access.take_version(answer.cluster_id, answer.access_version, channel)
                self._match_tasks()
        except grpc.aio.AioRpcError as error:
            why = str(await self._explained(target, from_rpc_error(error, target)))
            logger.debug("probe failed", extra={"event": "supernode_probe_failed", "target": target, "why": why})
            self._roster.note_failure(target, why)
            return False
        return answer.ready and accepted

    def _log_changes(self) -> None:
        """Log the changes since the last probe, each once: which supernodes can serve, and whether any can.

        The line about the end of a problem has the same level as the line about its beginning.
        """
        for change in self._status_log.changes(self._roster, asyncio.get_running_loop().time()):
            is_quiet = change.is_well and not change.is_return
            logger.log(
                logging.INFO if is_quiet else logging.WARNING,
                change.text,
                extra={"event": change.event, **change.facts},
            )

    async def _explained(self, target: str, error: StampedeError) -> StampedeError:
        if self._explain is None or not isinstance(error, Unavailable):
            return error
        return await self._explain(target) or error


def _log_defect(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        logger.error(
            "the probe of a supernode ended with a defect",
            exc_info=error,
            extra={"event": "task_defect", "task": task.get_name()},
        )


async def _ping(channel: grpc.aio.Channel, stub: directory_service_pb2_grpc.DirectoryServiceAsyncStub) -> ProbeAnswer:
    connected = channel.get_state() is grpc.ChannelConnectivity.READY
    began, sent_unix_nano = perf_counter_ns(), time_ns()
    pong = await stub.Ping(directory_service_pb2.DirectoryServicePingRequest(), timeout=PROBE_DEADLINE_SECONDS)
    took = perf_counter_ns() - began
    return ProbeAnswer(
        supernode_id=pong.supernode_id,
        cluster_id=pong.cluster_id,
        ready=pong.ready,
        round_trip_nanos=took if connected else None,
        former_cluster_ids=tuple(pong.former_cluster_ids),
        access_version=pong.access.version,
        clock=ClockOffset.measured(
            sent_unix_nano=sent_unix_nano,
            took_nanos=took,
            told_unix_nano=pong.time_unix_nano,
            supernode=pong.supernode_id,
        ),
    )


async def _list(stub: directory_service_pb2_grpc.DirectoryServiceAsyncStub) -> MemberList:
    listing = await stub.ListSupernodes(directory_service_pb2.ListSupernodesRequest(), timeout=PROBE_DEADLINE_SECONDS)
    members = tuple(
        Supernode(
            supernode_id=one.supernode_id,
            target=one.endpoint.target,
            zone=one.endpoint.zone,
            is_leader=one.is_leader,
        )
        for one in listing.supernodes
        if one.endpoint.target
    )
    return MemberList(term=listing.term, applied_index=listing.applied_index, members=members)
