"""The items of a channel for a recording, with the gaps and advances that the host reports, in the host's order."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.session import Session
from stampede_rt._async.stream_reconnector import StreamReconnector
from stampede_rt._async.subscription import Subscription
from stampede_rt.pacing.crediting import ITEM_OVERHEAD_BYTES, SteadyWindow
from stampede_rt.transports.concurrency_async import monotonic_s
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import error_pb2, item_pb2
from stampede_rt.values.model import Item
from stampede_rt.values.policy import MAX_FUTURE_DEFAULT_NANOS
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.timeline import MAX_INSTANT, Bound
from stampede_rt.wire.long_answers import LongRun
from stampede_rt.wire.reads import bound_to_message, reason_from_message

WINDOW_BYTES = 1024 * 1024  # the bytes that the host may send ahead of the recording, for each channel


@dataclass(slots=True)
class RecordedBatch:
    """The events since the last batch: items in seq order, gaps, and the last advance.

    `advance` is the instant of the advance, and the seq of the last item that the host accepted before the advance.
    `read_to`: this batch and the earlier ones have all items up to this seq, or name them as missing. None: the value
    of the batch before.
    `next_live_seq`: the host was lost, and the items after this batch are of the next incarnation, from this seq on.
    """

    items: list[Item] = field(default_factory=list)
    gaps: list[RecordingGap] = field(default_factory=list)
    advance: tuple[int, int] | None = None
    read_to: int | None = None
    next_live_seq: int | None = None

    def __bool__(self) -> bool:
        return bool(self.items or self.gaps or self.advance)


class RecordingStream(Subscription):
    """A subscription that gives batches. It reads from the host, never from shared memory, which reports no gaps.

    `opened_seq` is the seq of the first item after the subscription began; None before the host has answered.
    `names_losses`: the recording has a gap for the losses before the present incarnation already.
    """

    names_losses = False

    def __init__(
        self, session: Session, state: ChannelState, opening: channel_pb.SubscribeOpen, reconnecting: StreamReconnector
    ) -> None:
        super().__init__(session, state, opening, reconnecting)
        self._window = SteadyWindow(WINDOW_BYTES)
        self._batch = RecordedBatch()
        self._reported_advance: int | None = None
        self.opened_seq: int | None = None
        self.incarnation = self._next_incarnation = 0

    @classmethod
    def of(
        cls,
        session: Session,
        state: ChannelState,
        start: Bound | None,
        reconnect_name: str,
        *,
        held: bool,
        from_first: bool = False,
    ) -> RecordingStream:
        """Make the subscription. It gives the items from `start` on that the channel holds, and all later items.

        If `start` is None, it gives only the later items.

        `from_first`: all items of the present incarnation. The host then names the items that it no longer holds.
        """
        # A copy may serve a recording, because it sends all items, and only later than the owner.
        opening = channel_pb.SubscribeOpen(mode=channel_pb.SUBSCRIBE_MODE_ALL, stale_ok=True)
        if from_first:
            opening.after.CopyFrom(item_pb2.ItemPosition(seq=0, incarnation=state.info.incarnation))
        elif start is not None:
            opening.start.CopyFrom(bound_to_message(start))
        return cls(session, state, opening, StreamReconnector(session, reconnect_name, None, held=held))

    @property
    def read_to(self) -> int:
        """The last seq that has been read, skipped or named as missing."""
        cursor = self._cursor
        return (self.opened_seq or 1) - 1 if cursor is None else cursor.next_seq - 1

    @property
    def ended(self) -> bool:
        """Whether `close` has been called, or an error has ended the subscription."""
        return self._closed

    async def begin_reading(self) -> None:
        """Wait until the host has opened the subscription, or `close` is called. Raises the errors of `next_batch`."""
        self._session.check_process()
        async with self._steps:
            await self._open()

    async def next_batch(self) -> RecordedBatch | None:
        """Wait for items, gaps or an advance, and return them; None after `close`. Raises as `Subscription` does."""
        self._session.check_process()
        async with self._steps:
            while not self._closed:
                await self._open()
                batch = self._take_batch()
                if batch:
                    return batch
                await self._grant()
                await self._receive()
            return self._take_batch() or None

    def _take_batch(self) -> RecordedBatch:
        batch, self._batch = self._batch, RecordedBatch()
        batch.items = [*self._ready.take_all()]
        if batch.items:
            length_bytes = sum(item.payload_length_bytes for item in batch.items)
            self._window.take(length_bytes + ITEM_OVERHEAD_BYTES * len(batch.items), monotonic_s())
        batch.read_to = self.read_to
        return batch

    async def _follow_ring(self) -> None:
        return

    def _take(self, response: channel_pb.SubscribeResponse, runs: Sequence[LongRun]) -> None:
        if response.HasField("opened"):
            self._next_incarnation = response.opened.incarnation
            if self.opened_seq is None:
                self.incarnation, self.opened_seq = response.opened.incarnation, response.opened.next_seq
        if response.HasField("gap") and not (self.names_losses and self._is_archived_loss(response.gap)):
            self._batch.gaps.append(self._gap(response.gap))
        super()._take(response, runs)  # decodes the items; the advance follows them, and the gap is before them
        if response.HasField("progress") and response.progress.HasField("advance_unix_nano"):
            advance = response.progress.advance_unix_nano
            if advance != self._reported_advance:
                self._reported_advance = advance
                self._batch.advance = (advance, response.progress.next_seq - 1)

    def _gap(self, gap: channel_pb.SubscriptionGap) -> RecordingGap:
        if self._is_archived_loss(gap):
            return self._archived_loss(gap)
        if _is_loss(gap):
            return self._loss(gap)
        return RecordingGap(
            channel=self._state.info.name,
            incarnation=self.incarnation,
            reason=reason_from_message(gap.reason, gap.detail) or "UNKNOWN",
            detail=gap.detail,
            first_seq=gap.first_seq,
            last_seq=gap.last_seq,
            items=gap.items,
        )

    def _is_archived_loss(self, gap: channel_pb.SubscriptionGap) -> bool:
        """Whether an owner was lost before the present incarnation. The items before and after the gap have it."""
        return _is_loss(gap) and self.incarnation == self._next_incarnation

    def _archived_loss(self, gap: channel_pb.SubscriptionGap) -> RecordingGap:
        """Return the gap of a loss in the archive. No item has the seq before the gap."""
        last_seq = gap.first_seq - 1
        return RecordingGap(
            channel=self._state.info.name, incarnation=self.incarnation, reason="LOST", detail=gap.detail,
            first_seq=min(self.read_to + 1, last_seq), last_seq=last_seq,
        )  # fmt: skip

    def _loss(self, gap: channel_pb.SubscriptionGap) -> RecordingGap:
        """Return the gap at the end of the present incarnation. The items after the gap belong to the next incarnation.

        The next incarnation gives `gap.first_seq` to its first item. The former host may have given the same seq to an
        item that is lost, or that the recording has already read. So the gap begins after the last item that was read.
        """
        former, self.incarnation = self.incarnation, self._next_incarnation
        self._batch.next_live_seq = gap.first_seq
        return RecordingGap(
            channel=self._state.info.name, incarnation=former, reason="LOST", detail=gap.detail,
            first_seq=max(gap.first_seq, self.read_to + 1), end=self.latest_time(),
        )  # fmt: skip

    def latest_time(self) -> int | None:
        """Return an upper bound for the times of the items that the host has accepted so far; None: not known.

        A host accepts items up to `max_future` ahead of its clock. `apart_nanos` is the greatest possible difference
        between the clocks of this process and of the host.
        """
        clock, future = self._session.supernodes.clock, self._state.info.policy.max_future_nanos
        if clock is None:
            return None
        future = MAX_FUTURE_DEFAULT_NANOS if future is None else future
        return min(time.time_ns() + clock.apart_nanos + future, MAX_INSTANT)


def _is_loss(gap: channel_pb.SubscriptionGap) -> bool:
    """Whether an owner was lost with an unknown number of items. With a number, the archive lacks the items."""
    return gap.reason == error_pb2.ABSENCE_REASON_LOST and not gap.items
