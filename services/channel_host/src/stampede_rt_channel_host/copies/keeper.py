"""The copies at this host: begins them, reopens broken feeds, reports the loads, and ends removed copies."""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import NoReturn

import grpc

from stampede_rt.errors import ChannelNotFound, StampedeError, Unavailable
from stampede_rt.v1 import replica_pb2, subject_pb2
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.copy_state import SERVED_STALENESS_NANOS_MAX, CopyState, gone
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.copies.copy_feed import CopyFeed
from stampede_rt_channel_host.copies.replica_directory import FeedSource, ReplicaDirectory
from stampede_rt_channel_host.core.records import RecordedChannel

logger = logging.getLogger(__name__)

COPIES_MAX = 1000  # the feeds of one host; each has a stream and two tasks
READY_SECONDS_MAX = 5.0  # the longest wait of a caller that binds a new copy
PAUSE_SECONDS_MIN, PAUSE_SECONDS_MAX = 0.1, 2.0
REPLICA_PAUSE_SECONDS_MAX = 0.3  # a replica that has become the owner should learn of it soon
REPORT_SECONDS = 2.0
LOADS_MAX = 1000  # the most loads in one report


class _Copy:
    """One copy: its state, and the task that keeps its feed."""

    def __init__(self, record: RecordedChannel, state: CopyState) -> None:
        self.record = record
        self.state = state
        self.task: asyncio.Task[None] | None = None
        self.delivered_bytes = 0  # the delivered bytes as of the last report
        self.moved_epoch = 0  # the latest epoch of an owner that has sent the copy to the next owner


class CopyKeeper:
    """Keeps the copies of one host, on its event loop. `dial` opens connections to other hosts."""

    def __init__(
        self, identity: HostIdentity, store: ChannelStore, directory: ReplicaDirectory,
        dial: Callable[[str], grpc.aio.Channel], bytes_per_second: int = 0,
    ) -> None:  # fmt: skip
        """`bytes_per_second`: the most that each feed takes; 0: without a limit."""
        self._identity = identity
        self._store = store
        self._directory = directory
        self._dial = dial
        self._bytes_per_second = bytes_per_second
        self._copies: dict[bytes, _Copy] = {}
        self._paused: set[bytes] = set()  # the channels that move here, whose moves feed the copies
        store.copies.on_bound = self.begin
        self.target = ""  # the gatekeeper of this host; set before the host gets a lease

    async def begin(self, record: RecordedChannel) -> None:
        """Begin the copy of a channel unless there is one, and wait until it can serve readers.

        Waits READY_SECONDS_MAX at most. Raises StaleBinding (MOVED) if the copy cannot serve readers by then, and
        Unavailable if this host has too many copies.
        """
        if record.channel_id in self._paused:
            raise refusals.copy_cannot(record.name, "is about to become the owner")
        copy = self._copies.get(record.channel_id)
        if copy is None:
            if len(self._copies) >= COPIES_MAX:
                raise Unavailable(f"host {self._identity.name} has {COPIES_MAX} copies, the limit; use another host")
            copy = self._start(record, CopyState())
        await copy.state.ready(record.name, READY_SECONDS_MAX)

    def _start(self, record: RecordedChannel, state: CopyState) -> _Copy:
        """Keep the feed of a copy from now on."""
        copy = self._copies[record.channel_id] = _Copy(record, state)
        state.on_dropped = lambda: self._stop(record.channel_id, "the host has dropped it")
        self._begin_task(copy)
        logger.info("a copy begins", extra={"event": "copy_began", "channel": record.name})
        return copy

    def _begin_task(self, copy: _Copy) -> None:
        copy.task = asyncio.create_task(self._keep_until_stopped(copy), name=f"copy of {copy.record.name}")
        copy.task.add_done_callback(_check)

    def pause(self, channel_id: bytes) -> CopyState:
        """Let the move of a channel to this host feed its copy, until `resume`. Returns the state of that copy.

        A replica keeps its items: the owner may wait for it. A proxy is dropped, and its readers go to the owner.
        """
        self._paused.add(channel_id)
        self._stop(channel_id, "the channel moves here")
        copy = self._store.copies.of(channel_id)
        if copy is not None and copy.copy is not None and copy.copy.is_replica:
            copy.copy.caught_up = False  # so that the move waits until the replica is level
            state = copy.copy
        else:
            self._store.copies.drop(channel_id, gone(channel_id.hex()))
            state = CopyState()
        state.moves_here = True
        return state

    def resume(self, record: RecordedChannel, state: CopyState) -> None:
        """Note that a move is over. If it has failed, feed the replica again, or drop another copy."""
        self._paused.discard(record.channel_id)
        copy = self._store.copies.of(record.channel_id)
        if copy is not None and state.is_replica:
            state.may_inherit, state.moves_here = None, False
            self._start(copy.record, state)
        else:
            self._store.copies.drop(record.channel_id, gone(record.name))

    def demote(self, owner: HostedChannel, record: RecordedChannel) -> None:
        """Turn the former owner of a channel into a replica, and feed it from the new owner (`record`)."""
        state = CopyState()
        state.is_replica = True
        self._store.copies.demote(owner, record, state, self._store.now())
        self._start(record, state)

    async def report_forever(self) -> NoReturn:
        """Report the loads of the copies every REPORT_SECONDS."""
        while True:  # paced by the sleep
            await asyncio.sleep(REPORT_SECONDS)
            if loads := [*self._loads()]:
                await self._report(loads)

    async def aclose(self) -> None:
        """End all feeds."""
        tasks = [copy.task for copy in self._copies.values() if copy.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep_until_stopped(self, copy: _Copy) -> None:
        """Keep the feed of a copy until `_stop` cancels this task, or until this task itself makes the copy the owner.

        Drops the error of the cancellation: the error would keep its stream, and so a connection, until the garbage
        collector finds both.
        """
        with suppress(asyncio.CancelledError):
            await self._keep(copy)

    async def _keep(self, copy: _Copy) -> None:
        pause_s, source = PAUSE_SECONDS_MIN, None
        while self._copies.get(copy.record.channel_id) is copy:  # paced by the sleep, except once for each epoch
            try:
                source = await self._source_of(copy)
                if source is None:
                    return
                if source.host_id == self._identity.host_id:
                    await self._store.become_owner(copy.record.channel_id, source.epoch)
                elif source.target and self._store.lease_held():
                    await self._feed(copy, source)
            except StampedeError as error:
                extra = {"event": "copy_feed_broken", "channel": copy.record.name, "why": str(error)}
                logger.info("the feed of a copy is broken; the host tries again", extra=extra)
                if error.reason == "MOVED" and source is not None and copy.moved_epoch != source.epoch:
                    copy.moved_epoch = source.epoch
                    continue  # the directory has the new owner already, and puts may wait for this copy
            pause_max_s = REPLICA_PAUSE_SECONDS_MAX if copy.state.is_replica else PAUSE_SECONDS_MAX
            if copy.state.staleness_nanos < 2 * PAUSE_SECONDS_MAX * 10**9:
                pause_s = PAUSE_SECONDS_MIN
            await self._pause(copy, pause_s)
            pause_s = min(2 * pause_s, pause_max_s)

    async def _source_of(self, copy: _Copy) -> FeedSource | None:
        """The source of the copy. None if the directory no longer has the copy; then drops the copy."""
        channel_id, name = copy.record.channel_id, copy.record.name
        try:
            source = await self._directory.source_of(channel_id, self._identity.host_id)
        except ChannelNotFound:
            self._end(channel_id, refusals.deleted(name))
            return None
        if source is None:
            self._end(channel_id, gone(name))
        elif source.is_replica and not copy.state.is_replica:
            copy.state.is_replica = True
            copy.state.note_progress()
        return source

    async def _feed(self, copy: _Copy, source: FeedSource) -> None:
        channel = self._dial(source.target)
        feed = CopyFeed(
            self._store,
            copy.record,
            copy.state,
            self._identity.host_id,
            self.target,
            self._bytes_per_second,
            owner_facts=copy.state.is_replica,
        )
        try:
            await feed.run(source, channel)
        finally:
            copy.state.reconnects += 1
            await channel.close(None)

    async def _pause(self, copy: _Copy, pause_s: float) -> None:
        """Wait before the next try. End the readers of a copy that has become too old."""
        await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
        held = self._store.copies.of(copy.record.channel_id)
        if held is not None and copy.state.staleness_nanos > SERVED_STALENESS_NANOS_MAX:
            self._store.scheduler.begin(held.ending(refusals.copy_cannot(copy.record.name, "has lost its source")))

    def _end(self, channel_id: bytes, error: StampedeError) -> None:
        """Drop a copy; its readers get `error`."""
        self._stop(channel_id, error.message)
        self._store.copies.drop(channel_id, error)

    def _stop(self, channel_id: bytes, why: str) -> None:
        """Stop the feed of a copy. Idempotent."""
        copy = self._copies.pop(channel_id, None)
        if copy is None:
            return
        logger.info("a copy ends", extra={"event": "copy_ended", "channel": copy.record.name, "why": why})
        if copy.task is not None and copy.task is not asyncio.current_task():
            copy.task.cancel()

    def _loads(self) -> Iterator[replica_pb2.ReplicaLoad]:
        for channel_id, copy in [*self._copies.items()][:LOADS_MAX]:
            held = self._store.copies.of(channel_id)
            delivered = 0 if held is None else held.delivered_bytes
            rate, copy.delivered_bytes = max(0, delivered - copy.delivered_bytes) / REPORT_SECONDS, delivered
            yield replica_pb2.ReplicaLoad(
                subject=subject_pb2.Subject(channel_id=channel_id),
                host_id=self._identity.host_id,
                subscriptions=0 if held is None else len(held.subscriptions),
                delivered_bytes_per_second=round(rate),
                next_seq=0 if held is None else held.channel.next_seq,
                lag_nanos=copy.state.staleness_nanos,
            )

    async def _report(self, loads: list[replica_pb2.ReplicaLoad]) -> None:
        identity = self._identity
        try:
            removed = await self._directory.report(identity.host_id, identity.boot_incarnation, loads)
            await self._check_removed(removed)
        except StampedeError as error:
            logger.debug(
                "the loads of copies were not reported", extra={"event": "copy_loads_not_reported", "why": str(error)}
            )

    async def _check_removed(self, channel_ids: Sequence[bytes]) -> None:
        """Ask the directory for the copies that its leader does not know. End the feeds of the copies that it lacks.

        An answer that comes late may be wrong: a caller may have added the replica again, and the owner may count on
        its items. So the host first ends the feed of such a copy, and then asks once more.
        """
        for channel_id in channel_ids:
            copy = self._copies.get(channel_id)
            if copy is not None and await self._is_gone(channel_id):
                await self._look_up_anew(copy)

    async def _is_gone(self, channel_id: bytes) -> bool:
        try:
            return await self._directory.source_of(channel_id, self._identity.host_id) is None
        except ChannelNotFound:
            return True

    async def _look_up_anew(self, copy: _Copy) -> None:
        """End the feed of a copy, and keep the copy from its next lookup on."""
        if copy.task is not None:
            copy.task.cancel()
            await asyncio.wait([copy.task])
        if self._copies.get(copy.record.channel_id) is copy:
            self._begin_task(copy)


def _check(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (failure := task.exception()) is not None:
        logger.error(
            "a copy has ended with a defect", exc_info=failure, extra={"event": "task_defect", "task": task.get_name()}
        )
