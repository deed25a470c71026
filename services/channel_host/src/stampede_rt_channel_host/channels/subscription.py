"""One subscription: a cursor into the core and no queue. Its writer takes what gathered while its last write was in
flight (paper, section 4.1: push), so an idle stream adds no delay and a busy one amortises."""

from __future__ import annotations

import asyncio
from typing import Any

from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.reads import bound_from_message, reason_to_message
from stampede_rt_channel_host.channels.frames import MESSAGE_BYTES_MAX
from stampede_rt_channel_host.channels.group_access import Cursor, GroupAccess
from stampede_rt_channel_host.channels.hosted_channels import SUBSCRIPTIONS_MAX, HostedChannel
from stampede_rt_channel_host.channels.requests import position_of, position_to
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.channel import AllCursor, Channel, Delivery, Gap, NewestCursor, Position

PROGRESS_SECONDS = 4.0  # the contract says at least every 5 s
WRITE_SECONDS_MAX = 30.0


class _All:
    """SUBSCRIBE_MODE_ALL."""

    place = None

    def __init__(self, channel: Channel, cursor: AllCursor) -> None:
        self._channel = channel
        self._cursor = cursor

    def take(self, now: int) -> Delivery:
        return self._channel.since(self._cursor, now, MESSAGE_BYTES_MAX)

    def progress(self, now: int) -> pb.SubscriptionProgress:
        return pb.SubscriptionProgress(next_seq=self._cursor.next_seq, dropped=self._cursor.dropped)


class _Newest:
    """SUBSCRIBE_MODE_NEWEST."""

    place = None

    def __init__(self, channel: Channel, cursor: NewestCursor) -> None:
        self._channel = channel
        self._cursor = cursor

    def take(self, now: int) -> Delivery:
        latest = self._channel.latest(self._cursor, now)
        return Delivery(slices=(latest,)) if latest else Delivery()

    def progress(self, now: int) -> pb.SubscriptionProgress:
        return pb.SubscriptionProgress(next_seq=self._channel.next_seq, skipped=self._cursor.skipped)


class Subscription:
    """Serves one subscription. A `Listener` of its channel: everything happens on the event loop."""

    def __init__(
        self, hosted: HostedChannel, store: ChannelStore, groups: GroupAccess, context: Any, stream: OpenStream
    ) -> None:
        self._hosted = hosted
        self._store = store
        self._groups = groups
        self._context = context
        self._stream = stream
        self._news: asyncio.Future[bool] | None = None
        self._owes_progress = False  # a reader that began in the past is told when it has all that was held
        self._told_advance: int | None = None
        self._told_place: Position | None = None
        self._owes_place = False  # items were sent in the midst of a step, which has ended since
        self._silent_at_s = 0.0  # on the loop's clock: when a sign of life is due, whatever news wake it before

    def wake(self) -> None:
        """There may be something to send."""
        if self._news is not None and not self._news.done():
            self._news.set_result(True)

    def end(self, error: StampedeError) -> None:
        """The channel is not served any more."""
        self._stream.end(error)

    async def run(self, request: pb.SubscribeRequest) -> None:
        """Until the stream ends. Raises InvalidArgument, IncarnationLost, Overloaded."""
        if len(self._hosted.listeners) >= SUBSCRIPTIONS_MAX:
            raise Overloaded(
                f"channel {self._hosted.record.name} has {SUBSCRIPTIONS_MAX} subscriptions, which is the most"
            )
        if request.HasField("group_id"):
            async with self._groups.subscribe(request, self._hosted, self) as cursor:
                await self._serve(cursor, request)
        else:
            await self._serve(open_cursor(self._hosted.channel, request, self._store.now()), request)

    async def _serve(self, cursor: Cursor, request: pb.SubscribeRequest) -> None:
        channel = self._hosted.channel
        opened = pb.SubscriptionOpened(incarnation=channel.incarnation, next_seq=channel.next_seq)
        self._hosted.listeners[self] = None
        self._owes_progress = request.HasField("start")
        try:
            await self._write(pb.SubscribeResponse(opened=opened).SerializeToString() + self._place(cursor))
            while True:  # ends with the stream
                await self._step(cursor, without_payloads=request.without_payloads)
        finally:
            del self._hosted.listeners[self]

    async def _step(self, cursor: Cursor, *, without_payloads: bool) -> None:
        """Send what there is, or wait for more; after an advance, and after a long silence, say how far it is."""
        now = self._store.now()
        part = cursor.take(now)
        if not part.is_empty:
            message = self._hosted.messages.encode(
                part.slices,
                self._about(part, cursor, now),
                without_payloads=without_payloads,
                readers=len(self._hosted.listeners),
            )
            await self._write(message.encoded)
            self._hosted.count_delivered(message.payload_bytes)
            self._owes_place = cursor.place != self._told_place
        elif self._owes_place:
            self._owes_place = False
            await self._write(self._place(cursor))
        elif self._owes_progress or self._advance_is_news() or not await self._wait_for_news():
            self._owes_progress = False
            progress = self._progress(cursor, self._store.now())
            await self._write(pb.SubscribeResponse(progress=progress).SerializeToString())

    def _about(self, part: Delivery, cursor: Cursor, now: int) -> bytes:
        """What goes before the runs. Progress follows a gap, so that the reader knows its counters."""
        if part.gap is None:
            return self._place(cursor)
        about = pb.SubscribeResponse(gap=_gap(part.gap), progress=self._progress(cursor, now))
        return about.SerializeToString() + self._place(cursor)

    def _place(self, cursor: Cursor) -> bytes:
        """Behind which position to resume, if the reader is to be told, and does not know."""
        place = cursor.place
        if place is None or place == self._told_place:
            return b""
        self._told_place = place
        return pb.SubscribeResponse(resume_after=position_to(place)).SerializeToString()

    def _progress(self, cursor: Cursor, now: int) -> pb.SubscriptionProgress:
        progress = cursor.progress(now)
        progress.host_time_unix_nano = now
        self._told_advance = self._hosted.channel.advanced_to
        if self._told_advance is not None:
            progress.advance_unix_nano = self._told_advance
        return progress

    def _advance_is_news(self) -> bool:
        """Whoever waits for what cannot come any more, such as a match, is to know it at once."""
        return self._hosted.channel.advanced_to != self._told_advance

    async def _wait_for_news(self) -> bool:
        """True: look again; False: nothing was written for PROGRESS_SECONDS."""
        loop = asyncio.get_running_loop()
        news: asyncio.Future[bool] = loop.create_future()
        self._news = news
        timer = loop.call_at(self._silent_at_s, _set_unless_done, news)
        try:
            return await news
        finally:
            timer.cancel()

    async def _write(self, message: bytes) -> None:
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
        except TimeoutError:
            raise Overloaded(
                f"the reader of channel {self._hosted.record.name} took nothing for {WRITE_SECONDS_MAX:g} s, and its "
                "subscription is ended; read faster, or subscribe to the newest item only, and subscribe again"
            ) from None
        self._silent_at_s = asyncio.get_running_loop().time() + PROGRESS_SECONDS


def open_cursor(channel: Channel, request: pb.SubscribeRequest, now: int) -> Cursor:
    """Begin where the request says. Raises InvalidArgument, IncarnationLost."""
    start = bound_from_message(request.start, "the subscription's start") if request.HasField("start") else None
    after = position_of(request.after) if request.HasField("after") else None
    exclusive = request.start.exclusive
    if request.mode in (pb.SUBSCRIBE_MODE_UNSPECIFIED, pb.SUBSCRIBE_MODE_ALL):
        return _All(channel, channel.subscribe_all(now, start=start, start_exclusive=exclusive, after=after))
    if request.mode == pb.SUBSCRIBE_MODE_NEWEST:
        return _Newest(channel, channel.subscribe_newest(now, start=start, start_exclusive=exclusive, after=after))
    raise InvalidArgument(f"mode is {request.mode}; use a value of stampede_rt.v1.SubscribeMode")


def _gap(gap: Gap) -> pb.SubscriptionGap:
    return pb.SubscriptionGap(
        first_seq=gap.first_seq,
        last_seq=gap.last_seq,
        items=gap.items,
        reason=reason_to_message(gap.reason),
        detail=gap.reason.detail,
    )


def _set_unless_done(news: asyncio.Future[bool]) -> None:
    if not news.done():
        news.set_result(False)
