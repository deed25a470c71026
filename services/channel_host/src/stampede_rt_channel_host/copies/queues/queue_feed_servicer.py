"""The replica's side of `MigrationService.FeedQueue`: the owner of a queue feeds the copy at this host."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from functools import partial

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.cluster.records import recorded_queue
from stampede_rt_channel_host.copies.feed_callers import FeedCallers
from stampede_rt_channel_host.copies.queues.queue_puts import PUT_TAG, encode_answer, put_of, read_put
from stampede_rt_channel_host.copies.queues.queue_steps import ArrivingParts, WholeQueue
from stampede_rt_channel_host.copies.replica_directory import ReplicaDirectory
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from stampede_rt_channel_host.core.queue import AheadPut, QueueCore, QueueStep
from stampede_rt_channel_host.core.queue.handoff import freeing
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues import refusals
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_runtime.rpc import Context, answer_in_same_turn

SAME_TURN_BYTES_MAX = 2**18  # a longer request, or one with more steps, is left to the task that reads the feed
SAME_TURN_STEPS_MAX = 16
SIGN_SECONDS = 1.0  # the owner ends the feed of a replica that is silent for longer than ANSWER_SECONDS_MAX


class QueueFeeds:
    """Serves the feeds of the replicas at this host. `directory`: the directory of queues."""

    def __init__(
        self, identity: HostIdentity, queues: QueueStore, directory: ReplicaDirectory, callers: FeedCallers
    ) -> None:
        self._identity = identity
        self._queues = queues
        self._directory = directory
        self._callers = callers
        self._latest: dict[bytes, _Feed] = {}  # by queue: the feed that may change the copy

    async def serve(self, context: Context) -> None:
        """Take one feed until it ends. Raises the errors of MigrationService.FeedQueue."""
        first = await context.read()
        if not isinstance(first, pb.FeedQueueRequest) or len(first.owner_host_id) != ID_BYTES:
            raise InvalidArgument("the first request has no owner_host_id of 16 bytes; state it")
        if len(first.queue.queue_id) != ID_BYTES:
            raise InvalidArgument("the first request has no queue; state its record")
        await self._callers.check(context, first.owner_host_id)
        record = recorded_queue(first.queue)
        await self._check(record, first.owner_host_id)
        feed = self._latest[record.queue_id] = _Feed(self._queues, record)
        self._queues.copies.note_feed(record.queue_id)
        answer_in_same_turn(context, partial(self._take_in_same_turn, feed))
        try:
            await context.write(feed.place())
            while isinstance(request := await context.read(), pb.FeedQueueRequest):
                self._check_latest(feed)
                await self._take(feed, request, context)
                self._check_latest(feed)
                await context.write(feed.place())
        finally:
            feed.close()
            if self._latest.get(record.queue_id) is feed:
                del self._latest[record.queue_id]

    async def _take(self, feed: _Feed, request: pb.FeedQueueRequest, context: Context) -> None:
        """Apply a request. Sends signs of life while a thread restores a whole queue: the owner ends the feed of a
        silent replica.
        """
        taking = asyncio.ensure_future(feed.take(request, lambda: self._latest.get(feed.record.queue_id) is feed))
        try:
            while not (await asyncio.wait({taking}, timeout=SIGN_SECONDS))[0]:
                self._check_latest(feed)
                await context.write(feed.place())
            await taking
        finally:
            taking.cancel()

    def _take_in_same_turn(self, feed: _Feed, raw: bytes | memoryview, write: Callable[[bytes], None]) -> bool:
        """Repeat a few steps in the turn of the event loop in which they come, because callers of the owner wait."""
        if len(raw) > SAME_TURN_BYTES_MAX:
            return False
        self._check_latest(feed)
        if raw and raw[0] == PUT_TAG:
            return feed.take_put(read_put(raw), len(raw), write)
        request: pb.FeedQueueRequest = parse(pb.FeedQueueRequest, bytes(raw), "FeedQueueRequest")
        return feed.take_steps(request, lambda place: write(place.SerializeToString()))

    def _check_latest(self, feed: _Feed) -> None:
        """Raises StaleBinding (MOVED) if a later feed may change the copy.

        Raises StaleBinding (NOT_HERE) if this host has no lease: then it does not become the owner, so its answers must
        not count.
        """
        self._queues.check_may_serve()
        if self._latest.get(feed.record.queue_id) is not feed:
            raise refusals.moved(feed.record)

    async def _check(self, record: RecordedQueue, owner_host_id: bytes) -> None:
        """Raises StaleBinding (MOVED) unless the caller owns the queue, and this host has a replica of it."""
        self._queues.check_may_serve()
        source = await self._directory.source_of(record.queue_id, self._identity.host_id)
        if source is None or not source.is_replica:  # this host is itself the owner, or has no copy of the queue
            raise refusals.moved(record)
        if (source.host_id, source.epoch) != (owner_host_id, record.epoch):
            raise refusals.moved(record)
        if self._queues.known(record.queue_id) is not None and not self._gives_away(record):
            raise refusals.moved(record)

    def _gives_away(self, record: RecordedQueue) -> bool:
        """Drop the queue, if this host is its former owner. Returns whether it is."""
        hosted = self._queues.known(record.queue_id)
        if hosted is None or hosted.record.epoch >= record.epoch:
            return False
        self._queues.forget(record.queue_id, refusals.moved(record))
        return True


class _Feed:
    """One feed."""

    def __init__(self, queues: QueueStore, record: RecordedQueue) -> None:
        self._queues = queues
        self._copies = queues.copies
        self.record = record
        """The queue as its owner knows it."""
        self._parts = ArrivingParts()
        self._room = queues.memory.charge_for(record.created_by)

    def close(self) -> None:
        """Drop the parts that wait for the rest, because the feed ends."""
        self._room.set(0)
        self._queues.scheduler.begin(self._parts.freeing())

    def place(self) -> pb.FeedQueueResponse:
        """The place of the copy."""
        copy = self._copies.of(self.record.queue_id)
        if copy is None:
            return pb.FeedQueueResponse(takes_changes=True, takes_puts=True)
        return pb.FeedQueueResponse(
            next_step=copy.journal.next_step,
            incarnation=copy.record.incarnation,
            owner_epoch=copy.owner_epoch,
            takes_changes=True,
            takes_puts=True,
        )

    async def take(self, request: pb.FeedQueueRequest, is_latest: Callable[[], bool]) -> None:
        """Apply a request. `is_latest`: whether no other feed of the copy has begun. Raises StaleBinding (MOVED)."""
        for arrived in self._arrivals(request):
            if isinstance(arrived, WholeQueue):
                core = await asyncio.to_thread(self._restored, arrived)
                try:
                    self._begin(core, arrived.next_step, is_latest)
                except StampedeError:
                    self._queues.scheduler.begin(core.emptying())
                    raise
            else:
                self._repeat(*arrived)
        if request.HasField("put") and (copy := self._copies.of(self.record.queue_id)) is not None:
            self._copies.apply(copy, copy.journal.step_of(put_of(request.put)), 0)
        self._note(self.record.queue_id)

    def _begin(self, core: QueueCore, next_step: int, is_latest: Callable[[], bool]) -> None:
        """Keep the restored queue as the copy. Raises StaleBinding (MOVED), and Overloaded without room for it."""
        # the queue may have another owner now, perhaps this host
        if not is_latest() or self._queues.known(self.record.queue_id) is not None:
            raise refusals.moved(self.record)
        self._copies.begin(self.record, core, next_step)

    def _restored(self, arrived: WholeQueue) -> QueueCore:
        state = arrived.state()
        core = self._copies.restored(self.record, state)
        run_to_end(freeing(state))  # in one step the interpreter would run no other thread meanwhile
        return core

    def take_put(self, put: AheadPut, request_bytes: int, write: Callable[[bytes], None]) -> bool:
        """Apply a request that is a put. Returns False, and does nothing, if the copy might refuse it.

        Like `take_steps`, it answers the request before this host repeats the step.
        """
        queue_id = self.record.queue_id
        copy = self._copies.of(queue_id)
        if copy is None or not copy.journal.surely_takes_put(put) or self._queues.known(queue_id) is not None:
            return False
        self._room.claim(request_bytes)
        write(encode_answer(put.number + 1))
        self._copies.apply(copy, copy.journal.step_of(put), 0)
        self._note(queue_id)
        return True

    def take_steps(self, request: pb.FeedQueueRequest, answer: Callable[[pb.FeedQueueResponse], None]) -> bool:
        """Apply a request that has a few steps. Returns False, and does nothing, if it has more steps, or a part of a
        queue.

        Calls `answer` with the place after the request, as soon as nothing can fail: callers of the owner wait for it.
        Does not wait.
        """
        if request.begins_anew or self._parts.is_whole or len(request.parts) > SAME_TURN_STEPS_MAX:
            return False
        # no whole queue is on its way
        steps = [one for one in self._arrivals(request) if not isinstance(one, WholeQueue)]
        early = self._place_after(steps)
        if early is not None:
            answer(early)
        for step in steps:
            self._repeat(*step)
        self._note(self.record.queue_id)
        if early is None:
            answer(self.place())
        return True

    def _place_after(self, steps: list[tuple[QueueStep, int]]) -> pb.FeedQueueResponse | None:
        """The place of the copy after one step that surely fits; None if the copy must try."""
        copy = self._copies.of(self.record.queue_id)
        if copy is None or len(steps) != 1 or not copy.journal.surely_takes(step := steps[0][0]):
            return None
        return pb.FeedQueueResponse(
            next_step=step.number + 1, incarnation=copy.record.incarnation, owner_epoch=self.record.epoch
        )

    def _arrivals(self, request: pb.FeedQueueRequest) -> Iterator[WholeQueue | tuple[QueueStep, int]]:
        """Check a request, and take its parts in. Returns the things that are complete now."""
        queue_id = self.record.queue_id
        if request.HasField("queue"):
            if request.queue.queue_id != queue_id:  # the caller has shown that it owns this queue, and no other one
                raise InvalidArgument("the feed of a queue names another queue; open a feed for each queue")
            self.record = recorded_queue(request.queue)
        if request.begins_anew:
            self._copies.drop(queue_id)
            self._parts.begin_anew()
        elif self._queues.known(queue_id) is not None:
            raise refusals.moved(self.record)
        self._room.claim(request.ByteSize())
        return self._parts.add(request.parts)

    def _repeat(self, step: QueueStep, ago_nanos: int) -> None:
        copy = self._copies.of(self.record.queue_id)
        if copy is not None:
            self._copies.apply(copy, step, ago_nanos)

    def _note(self, queue_id: bytes) -> None:
        copy = self._copies.of(queue_id)
        if copy is not None:
            self._copies.note_message(copy, self.record)
            self._queues.in_use.set()  # so that this host watches who owns its queues
        self._room.set(self._parts.size_bytes)
