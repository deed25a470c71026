"""Subscriptions: a reader gets items as the host accepts them, also after a broken connection (paper, section 3.2)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Any

from stampede_rt._async.batches import Batches
from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.copies import copy_target_of, open_at_owner_or_copy
from stampede_rt._async.ring_following import RingFollower
from stampede_rt._async.ring_reads import HostMustAnswer
from stampede_rt._async.session import Session
from stampede_rt._async.stream_reconnector import StreamReconnector, loss_after, may_heal
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import IncarnationLost, StampedeError, Unavailable
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.crediting import ONE_ITEM, CreditWindow, cost_of
from stampede_rt.transports.concurrency_async import StepLock, StepTask, begin_if_blocking, monotonic_s
from stampede_rt.transports.streams_async import BidiStream
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import error_pb2
from stampede_rt.values.answers import ItemBatch
from stampede_rt.values.model import Item
from stampede_rt.values.reading import SubscribeMode
from stampede_rt.values.ready_items import ReadyItems, SeenSeqs
from stampede_rt.values.statistics import MulticastStats
from stampede_rt.values.timeline import Bound
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.long_answers import LongRun, SubscribeAnswer
from stampede_rt.wire.subscribing import beginning

_log = logging.getLogger("stampede_rt")

NO_RING_S = 0.25  # after a ring did not have the next items, the subscription stays with the host for this time


class Subscription(BoundToProcess):
    """An iterator over items (see `Channel.subscribe`), and a context manager.

    Each step blocks until the next item. In mode "newest" the host sends one item for each step, the newest at that
    moment. In mode "all" it sends ahead as much as the reader takes in a tenth of a second, and at most 2 MiB.

    `skipped` counts items that mode "newest" left out. `dropped` counts items that retention collected before a slow
    reader took them. `losses` counts the gaps of lost items: a replica took over after the loss of the host and may
    have lacked the latest items, or the archive of the channel lacks items. After such a gap the subscription logs a
    warning and continues. `close` ends the iteration. A step raises ChannelNotFound when the channel is deleted, and
    Unavailable if the client could not reach the host for the duration `reconnect`. It raises IncarnationLost if the
    channel's host was lost with its items. Subscribe again to read the new incarnation.
    """

    def __init__(
        self, session: Session, state: ChannelState, opening: channel_pb.SubscribeOpen, reconnecting: StreamReconnector
    ) -> None:
        self._session = session
        self._reconnecting = reconnecting
        self._state = state
        self._opening = opening  # the first request of the next stream
        self._stream: BidiStream[SubscribeAnswer] | None = None
        self._responses: Any = None
        self._decoder: ItemDecoder | None = None
        self._ready = ReadyItems()
        self._ready_bytes = 0  # the credit that all items of the last response cost
        self._for_batch = False  # whether the present step returns a batch
        self._steps = StepLock()  # callers that step at the same time take turns
        self._step_task = StepTask()
        newest_only = opening.mode == channel_pb.SUBSCRIBE_MODE_NEWEST
        self._window = CreditWindow(ONE_ITEM) if newest_only else CreditWindow()
        self._cursor: channel_pb.SubscriptionCursor | None = None  # where the next stream begins after a break
        # The items that came after the cursor. After a break the next stream sends these items again.
        self._since_cursor = SeenSeqs()
        self._skipped_before = 0  # sum of earlier streams; on each stream the host counts from 0
        self._sent_to = ""  # the gatekeeper of the copy at which the host wants the reader to continue
        self._closed = False
        self._follower: RingFollower | None = None  # while the items come from shared memory, without a stream
        self._no_ring_before_s = 0.0
        self.skipped = 0
        self.dropped = 0
        self.losses = 0

    @property
    def multicast(self) -> MulticastStats | None:
        """The counts of datagrams; None if the subscription does not use `via="multicast"`."""
        return None

    @classmethod
    def begin(
        cls,
        session: Session,
        state: ChannelState,
        *,
        start: Bound | None,
        mode: SubscribeMode,
        after: Item | None,
        payloads: bool,
        reconnecting: StreamReconnector,
        group_id: bytes | None = None,
        stale_ok: bool = True,
    ) -> Subscription:
        """Check the arguments and make the subscription. The blocking client also opens it. Raises InvalidArgument."""
        opening = beginning(start, mode, after)
        opening.without_payloads, opening.stale_ok = not payloads, stale_ok
        if group_id is not None:
            opening.group_id = group_id
        self = cls(session, state, opening, reconnecting)
        begin_if_blocking(self._open)
        return self

    @property
    def reconnects(self) -> int:
        """The number of times that the client has opened the subscription again after a break."""
        return self._reconnecting.reconnects

    @property
    def connected(self) -> bool:
        """Whether the subscription is open, as last known. False while the client opens it again, and after its end."""
        return self._reconnecting.connected and not self._closed

    def __repr__(self) -> str:
        state = self._session.state or ("closed" if self._closed else "")
        return f"<Subscription to channel {self._state.info.name!r}{f', {state}' if state else ''}>"

    async def __aenter__(self) -> Subscription:
        self._session.check_process()
        async with self._steps:
            await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> Subscription:
        return self

    async def __anext__(self) -> Item:
        self._session.check_process()
        ready = self._ready
        async with self._steps:
            while not self._closed:
                if ready.items:
                    item = ready.items.popleft()
                    if not ready.items and not ready:
                        self._took_all(cost_of((item,)))
                    return item
                if not ready.unpack():
                    self._for_batch = False
                    await self._step_task.run(self._advance)
            raise StopAsyncIteration

    def batches(self) -> Batches:
        """Return an iterator over batches (see `Batches`): each step waits for the next item, and returns a batch."""
        return Batches(self._next_batch)

    async def _next_batch(self) -> ItemBatch | None:
        """Wait for items and return them; None after `close`."""
        self._session.check_process()
        async with self._steps:
            while not self._closed:
                if self._ready:
                    batch = self._ready.take_all()
                    self._took_all(self._ready_bytes)
                    return batch
                self._for_batch = True
                await self._step_task.run(self._advance)
            return None

    async def _advance(self) -> None:
        """Take the next items, or wait for some."""
        if self._follower is None:
            await self._open()
            await self._follow_ring()
        if self._follower is not None:
            await self._step_in_ring(self._follower)
            return
        await self._grant()
        if not self._ready:
            await self._receive()

    def _took_all(self, last_bytes: int) -> None:
        """Note in the credit window that the program has taken all ready items.

        `last_bytes`: the credit of the items that the last step took.
        """
        if self._follower is None:
            self._window.take_all(self._ready_bytes, last_bytes, monotonic_s())
            self._ready_bytes = 0

    async def _follow_ring(self) -> None:
        """If the channel has a ring with the next items, take them from there from now on, and end the stream."""
        cursor, stream = self._cursor, self._stream
        if stream is None or cursor is None or monotonic_s() < self._no_ring_before_s:
            return
        if self._ready or self._opening.HasField("group_id") or self._opening.without_payloads:
            return
        mapping = await self._session.rings.find(self._state)
        if mapping is None:
            return
        newest_only = self._opening.mode == channel_pb.SUBSCRIBE_MODE_NEWEST
        follower = RingFollower(self._state, mapping, cursor, self._session.rings.waits, newest_only=newest_only)
        if follower.fits():
            self._follower, self._stream, self._skipped_before = follower, None, self.skipped
            stream.cancel()
        else:
            self._no_ring_before_s = monotonic_s() + NO_RING_S

    async def _step_in_ring(self, follower: RingFollower) -> None:
        """Take the next items from the ring, or wait a moment for some. Goes back to the host if the ring has ended."""
        try:
            runs = await follower.step(for_batch=self._for_batch)
        except StampedeError:  # the ring is damaged
            self._leave_ring(follower)
            raise
        if isinstance(runs, HostMustAnswer):
            self._leave_ring(follower)
        else:
            self._ready.add(runs)
            self.skipped = self._skipped_before + follower.skipped

    def _leave_ring(self, follower: RingFollower) -> None:
        self._follower, self._cursor = None, follower.cursor
        self._no_ring_before_s = monotonic_s() + NO_RING_S
        self._resume()

    def close(self) -> None:
        """End the subscription.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._session.check_thread()
        self._closed = True
        self._reconnecting.stop()
        stream = self._stream
        if stream is not None:
            stream.cancel()
        follower = self._follower
        if follower is not None:
            self._session.rings.waits.wake(follower.mapping)

    async def _open(self) -> None:
        """Open a stream to the channel's present host unless one is open, and wait for the host's first response."""
        if self._stream is not None or self._closed:
            return
        try:
            with span("subscribe", channel=self._state.info.name):
                await self._reconnecting.open(self._open_within)
        except IncarnationLost as error:
            self._closed = True
            if self._cursor is None:  # the caller's start or item is of another incarnation
                raise
            raise loss_after(self._state.info.name, self._cursor.next_seq) from error
        except StampedeError as error:
            self._closed = not may_heal(error)
            raise

    async def _open_within(self, timeout_s: float) -> None:
        await self._session.perform(self._state, self._open_at, timeout_s)

    async def _open_at(self, owner: Binding, _: float) -> None:
        target, self._sent_to = self._sent_to, ""
        await open_at_owner_or_copy(self._session, self._state, owner, target, self._opening, self._open_stream)

    async def _open_stream(self, binding: Binding) -> None:
        self._opening.channel_id, self._opening.epoch = binding.subject_id, binding.epoch
        endpoint = self._session.endpoints.to(binding.target)
        stream: BidiStream[SubscribeAnswer] = endpoint.open_read_bidi(endpoint.subscribe)
        try:
            await stream.send(channel_pb.SubscribeRequest(open=self._opening))
            responses = stream.__aiter__()
            first, runs = await responses.__anext__()
        except BaseException:
            stream.cancel()
            raise
        self._stream, self._responses = stream, responses
        if self._closed:  # the program called `close` during the opening
            stream.cancel()
        self._window.begin()
        self._ready_bytes = 0
        self._decoder = self._state.decoder(first.opened.incarnation, payloads=not self._opening.without_payloads)
        self._take(first, runs)

    async def _grant(self) -> None:
        """Let the host send as many bytes as the reader has room for."""
        stream = self._stream
        if stream is None or not (credit := self._window.ask(monotonic_s(), for_batch=self._for_batch)):
            return
        request = channel_pb.SubscribeRequest(credit_bytes=credit, one_response=self._window.is_for_one)
        try:
            with suppress(Unavailable):  # the iteration raises the reason of a broken stream
                await stream.send(request)
        except BaseException:  # an interrupt: the credit at the host is unknown
            stream.cancel()
            self._resume()
            raise

    async def _receive(self) -> None:
        try:
            self._take(*await self._responses.__anext__())
        except StopAsyncIteration:  # the program called `close`, or cancelled an earlier step
            self._resume()
        except StampedeError as error:
            self._resume()
            if not may_heal(error):
                self._closed = True
                raise
            self._sent_to = copy_target_of(error)
            if self._sent_to:  # the stream continues at a copy, and is not broken
                return
            self._reconnecting.broke()
            self._session.cache.forget(self._state.info.channel_id)
            self._session.cache.follow(self._state.info.channel_id, error.metadata)

    def _resume(self) -> None:
        """Prepare the next stream. It continues after the last item, without a gap and without a repetition."""
        self._stream = None
        self._skipped_before = self.skipped
        if self._cursor is not None:
            self._opening.cursor.CopyFrom(self._cursor)

    def _take(self, response: channel_pb.SubscribeResponse, runs: Sequence[LongRun]) -> None:
        """Take a response. `runs`: the runs of a long response, which are not in `response`."""
        if response.HasField("gap"):
            self._count_gap(response.gap)
        if self._decoder is not None and (response.runs or runs):
            received = self._decoder.decode_long(runs) if runs else self._decoder.decode_each(response.runs)
            unseen = self._unseen(received)
            self._ready.add(unseen)
            self._ready_bytes += sum(map(cost_of, unseen))
        if response.HasField("cursor"):
            self._cursor = response.cursor
            if not response.HasField("opened"):  # an "opened" response only repeats the cursor of the request
                self._since_cursor.forget_before(response.cursor.next_seq, response.cursor.cut_unix_nano)
        if response.HasField("progress"):
            self.skipped = self._skipped_before + response.progress.skipped

    def _count_gap(self, gap: channel_pb.SubscriptionGap) -> None:
        self.dropped += gap.items
        if gap.reason == error_pb2.ABSENCE_REASON_LOST:
            self.losses += 1
            _log.warning("a subscription to channel %r continues after a loss: %s", self._state.info.name, gap.detail)

    def _unseen(self, runs: list[Sequence[Item]]) -> Sequence[Sequence[Item]]:
        """Return the runs without the items that came before."""
        if not self._opening.HasField("group_id"):
            return runs  # without a group, each response with items has a cursor
        unseen = self._since_cursor.unseen(runs)
        self._window.drop(sum(map(cost_of, runs)) - cost_of(unseen))
        return [unseen]
