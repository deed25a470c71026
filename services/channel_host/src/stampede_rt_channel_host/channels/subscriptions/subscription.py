"""Serves one subscription (paper, section 4.1: push). A subscription has a cursor into the core, and no queue.

The items that came during one write go out in the next message, as far as its size limit allows. So an idle stream adds
no delay, and a busy stream sends large messages.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from functools import lru_cache

from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.reads import reason_to_message
from stampede_rt_channel_host.channels import copied_archives
from stampede_rt_channel_host.channels.copy_state import Freshness
from stampede_rt_channel_host.channels.frames import MESSAGE_BYTES_MAX, Delivery
from stampede_rt_channel_host.channels.group_access import Cursor, GroupAccess
from stampede_rt_channel_host.channels.hosted_channels import SUBSCRIPTIONS_MAX, HostedChannel
from stampede_rt_channel_host.channels.observers import ChangeObserver
from stampede_rt_channel_host.channels.requests import parse, saved_to, wanted_next_seq
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.credit import Credit, requests_of
from stampede_rt_channel_host.channels.subscriptions.cursors import files_came, losses_at, open_cursor
from stampede_rt_channel_host.channels.subscriptions.multicast_reader import MulticastReader, offers_multicast
from stampede_rt_channel_host.channels.subscriptions.reader_drops import ReaderDrops
from stampede_rt_channel_host.core.channel import Gap, SavedCursor, SubscriptionBatch
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.rpc import Context, takes_parts

# after this time without a message, the reader gets a progress message; the contract says at least every 5 s
PROGRESS_SECONDS = 4.0
CURSORS_KEPT = 64  # encoded cursors, each of about 100 bytes
STAY_SECONDS = 10.0  # a reader that could not reach a copy stays at least this long
WRITE_SECONDS_MAX = 30.0  # if the reader takes nothing for this time during a write, the subscription ends


class Subscription(ChangeObserver):
    """Serves one subscription. Observes its channel and its group, on the event loop."""

    def __init__(
        self, hosted: HostedChannel, store: ChannelStore, groups: GroupAccess, context: Context, stream: OpenStream
    ) -> None:
        super().__init__()
        self._hosted = hosted
        self._store = store
        self._groups = groups
        self._context = context
        self._takes_parts = takes_parts(context)
        self._stream = stream
        self._wakeup: asyncio.Future[bool] | None = None  # belongs to the present or last wait; see `_wait_for_change`
        # whether the reader must still get a progress message after the items that the channel held at its start
        self._owes_progress = False
        # the latest advance, cursor and count of skipped items that the reader has got
        self._sent_advance: int | None = None
        self._sent_cursor: SavedCursor | None = None
        self._sent_skipped = 0
        self._work = current_work()
        self._owes_cursor = False  # whether the reader must get the next cursor as soon as there is one
        self._credit = Credit(self._look)
        self._multicast = MulticastReader()
        self._drops = ReaderDrops(hosted.record.name, "")  # `_serve` enters it in the host's table
        self._movable_at_s: float | None = None  # loop time from which the reader may move to a copy; None: it may not
        self._reads_archive = False  # whether the last part came from the archive
        self._silent_at_s = 0.0  # loop time at which a progress message is due; only a write postpones it

    def wake(self) -> None:
        """Note that there may be items to send."""
        if self._credit.amount_left > 0:
            self._look()

    def _look(self) -> None:
        """End the present wait of `_wait_for_change`, if there is one."""
        if self._wakeup is not None and not self._wakeup.done():
            self._wakeup.set_result(True)

    def end(self, error: StampedeError) -> None:
        """Note that the host no longer serves the channel."""
        self._stream.end(error)

    async def run(self, request: pb.SubscribeRequest) -> None:
        """Serve until the stream ends, or until the reader has closed its side and its credit is spent.

        `request` is the first request of the stream. Raises InvalidArgument for an invalid request, IncarnationLost for
        a cursor of another incarnation, StaleBinding if the channel has left the host, and the errors of `GroupAccess`.
        Raises Overloaded if the channel has too many subscriptions, or if the reader takes nothing for
        WRITE_SECONDS_MAX.
        """
        try:
            await self._run(request)
        finally:
            self._credit.close()

    async def _run(self, request: pb.SubscribeRequest) -> None:
        opening = request.open
        if len(self._hosted.subscriptions) >= SUBSCRIPTIONS_MAX:
            raise Overloaded(
                f"channel {self._hosted.record.name} has {SUBSCRIPTIONS_MAX} subscriptions, the limit; end some"
            )
        self._check_place(opening)
        if self._hosted.copy is not None:
            channel, wanted = self._hosted.channel, wanted_next_seq(opening)
            await self._hosted.copy.reach(self._hosted.record.name, lambda: channel.next_seq, wanted)
        self._credit.grant(request.credit_bytes, one_response=request.one_response)
        reading = self._stream.spawn(self._read())
        try:
            if opening.HasField("group_id"):
                async with self._groups.subscribe(opening, self._hosted, self) as cursor:
                    await self._serve(cursor, opening)
            else:
                await files_came(self._hosted, opening, self._store.now())
                lost_at = await losses_at(self._hosted, opening, self._store.now())
                cursor = await self._store.scheduler.do(open_cursor(self._hosted, opening, self._store.now(), lost_at))
                # The channel may have left the host meanwhile.
                self._store.find_readable(opening.channel_id, opening.epoch, Freshness())
                with self._multicast.joined(self._store.multicasts, self._hosted, opening):
                    await self._serve(cursor, opening)
        finally:
            reading.cancel()

    def _check_place(self, opening: pb.SubscribeOpen) -> None:
        """Note whether the reader may move to a copy. Raises StaleBinding (MOVED) if it is to begin at another host."""
        hosted = self._hosted
        if not opening.stale_ok or offers_multicast(opening, self._store.multicasts):
            return
        self._movable_at_s = asyncio.get_running_loop().time() + (STAY_SECONDS if opening.stay else 0)
        if hosted.fed is not None and not opening.stay:
            redirect_error = hosted.fed.less_loaded(hosted.record.name, len(hosted.subscriptions))
            if redirect_error is not None:
                raise redirect_error

    @property
    def may_move(self) -> bool:
        """See `MovableReader`."""
        at_s = None if self._reads_archive else self._movable_at_s
        return at_s is not None and at_s <= asyncio.get_running_loop().time()

    async def _read(self) -> None:
        """Read requests that grant credit."""
        async for raw in requests_of(self._context.read):
            request: pb.SubscribeRequest = parse(pb.SubscribeRequest, raw, "SubscribeRequest")
            if request.HasField("open"):
                raise InvalidArgument("the stream is open already; leave `open` out after the first request")
            if request.HasField("repair_next_seq"):
                self._multicast.request_repair(request)
                self._look()
            else:
                self._credit.grant(request.credit_bytes, one_response=request.one_response)
        self._credit.end()

    async def _serve(self, cursor: Cursor, opening: pb.SubscribeOpen) -> None:
        channel = self._hosted.channel
        self._check_held(cursor)
        opened = pb.SubscriptionOpened(incarnation=channel.incarnation, next_seq=channel.next_seq)
        self._hosted.subscriptions.add(self)
        self._owes_progress = opening.HasField("start")
        try:
            await self._write(pb.SubscribeResponse(opened=opened).SerializeToString() + self._cursor_bytes(cursor))
            with self._store.readers.reading(self._hosted.record.name) as self._drops:
                while not self._credit.is_over:
                    cursor = await self._repair_cursor(cursor)
                    await self._step(cursor, without_payloads=opening.without_payloads)
        finally:
            self._hosted.subscriptions.discard(self)

    async def _repair_cursor(self, cursor: Cursor) -> Cursor:
        """The cursor of the repair for which a reader of datagrams has asked. `cursor` if it has asked for none."""
        if not self._multicast.has_repair_request or (saved := cursor.saved) is None:
            return cursor
        place = self._multicast.begin_repair(saved.incarnation)  # the reader may still know only the former incarnation
        self._owes_progress = True  # the answer if there is no item
        self._credit.amount_left = self._multicast.repair_bytes
        return await self._store.scheduler.do(open_cursor(self._hosted, place, self._store.now()))

    async def _step(self, cursor: Cursor, *, without_payloads: bool) -> None:
        """Send the new items, or wait for them. Send the progress after an advance and after a long silence.

        Without credit, only waits for credit: the cursor stays where it is, and the reader gets nothing.
        """
        if self._credit.amount_left <= 0:
            await self._wait_for_change(None)
            return
        if self._work.must_wait:
            await self._work.turn()
        self.listen()
        now = self._store.now()
        part = await self._take(cursor, now, min(self._credit.amount_left, MESSAGE_BYTES_MAX))
        if part.gap is not None or cursor.skipped != self._drops.skipped:
            self._drops.count(self._drops.collected + (part.gap.items if part.gap else 0), cursor.skipped)
        if not part.is_empty:
            items = sum(one.slice.items for one in part.slices)
            delivery = self._delivery_of(part, cursor, now, without_payloads=without_payloads)
            del part  # so that a joined message does not keep its runs in memory while it is written
            self._work.spend_write()
            await self._write(delivery.message(takes_parts=self._takes_parts))
            self._hosted.count_delivered(items, delivery.payload_bytes)
        elif part.more:
            await asyncio.sleep(0)
        elif self._owes_cursor and cursor.saved is not None:
            await self._write(self._cursor_bytes(cursor))
        elif self._owes_progress or self._has_new_advance() or not await self._wait_for_change(self._silent_at_s):
            self._owes_progress = False
            self._sent_advance = self._hosted.channel.advanced_to  # all items from before the advance are sent
            progress = pb.SubscribeResponse(progress=self._progress(cursor, self._store.now()))
            await self._write(progress.SerializeToString() + self._cursor_bytes(cursor))

    async def _take(self, cursor: Cursor, now: int, limit_bytes: int) -> SubscriptionBatch:
        """The next part: from the archive if memory does not have it any more."""
        recording = self._hosted.recording
        if recording is not None:
            archived = await cursor.from_archive(recording, limit_bytes, self._store.now)
            self._reads_archive = archived is not None
            if archived is not None:
                return archived
        elif self._hosted.copy is not None:
            self._check_held(cursor)
        return cursor.take(now, limit_bytes)

    def _check_held(self, cursor: Cursor) -> None:
        """Raises StaleBinding (MOVED) if only the owner's archive may have the next items."""
        if copied_archives.lacks_archive(self._hosted) and not cursor.is_held(self._store.now()):
            raise copied_archives.refusal(self._hosted)

    def _delivery_of(self, part: SubscriptionBatch, cursor: Cursor, now: int, *, without_payloads: bool) -> Delivery:
        delivery = self._hosted.deliveries.encode(
            part.slices,
            self._about(part, cursor, now),
            without_payloads=without_payloads,
            readers=len(self._hosted.subscriptions),
        )
        self._credit.spend(delivery.charge_bytes)
        return delivery

    def _about(self, part: SubscriptionBatch, cursor: Cursor, now: int) -> bytes:
        """The encoded fields before a message's runs: the gap, the progress if its counters changed, and the cursor."""
        if part.gap is None and cursor.skipped == self._sent_skipped:
            return self._cursor_bytes(cursor)
        about = pb.SubscribeResponse(progress=self._progress(cursor, now))
        if part.gap is not None:
            about.gap.CopyFrom(_gap(part.gap))
        return about.SerializeToString() + self._cursor_bytes(cursor)

    def _cursor_bytes(self, cursor: Cursor) -> bytes:
        """The cursor as an encoded response; no bytes if it is unchanged since the reader last got it."""
        saved, fields = cursor.saved, b""
        if self._multicast.is_joined:
            if self._multicast.is_owed:
                self._credit.amount_left = 0  # the reader wants no further response
            fields = self._multicast.encoded_fields()
        self._owes_cursor = saved is None  # a group has no cursor while it shows the items up to a new cut
        if saved is None or saved == self._sent_cursor:
            return fields
        self._sent_cursor = saved
        return fields + _encoded_cursor(saved)

    def _progress(self, cursor: Cursor, now: int) -> pb.SubscriptionProgress:
        progress = cursor.progress(now)
        self._sent_skipped = progress.skipped
        progress.host_time_unix_nano = now
        if self._sent_advance is not None:
            progress.advance_unix_nano = self._sent_advance
        return progress

    def _has_new_advance(self) -> bool:
        """Whether there is an advance that the reader does not know. No earlier item comes after an advance."""
        return self._hosted.channel.advanced_to != self._sent_advance

    async def _wait_for_change(self, until_s: float | None) -> bool:
        """Wait until there may be something to send. Returns False at the loop time `until_s`, if given."""
        if self._multicast.has_repair_request:  # the request came before this wait began
            return True
        loop = asyncio.get_running_loop()
        wakeup: asyncio.Future[bool] = loop.create_future()
        self._wakeup = wakeup
        timer = None if until_s is None else loop.call_at(until_s, _set_unless_done, wakeup)
        try:
            return await wakeup
        finally:
            if timer is not None:
                timer.cancel()

    async def _write(self, message: bytes | Sequence[bytes]) -> None:
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
        except TimeoutError:
            raise Overloaded(
                f"the reader of channel {self._hosted.record.name} took nothing for {WRITE_SECONDS_MAX:g} s, and its "
                "subscription is ended; read faster, or subscribe to the newest item only, and subscribe again"
            ) from None
        self._silent_at_s = asyncio.get_running_loop().time() + PROGRESS_SECONDS


@lru_cache(maxsize=CURSORS_KEPT)
def _encoded_cursor(saved: SavedCursor) -> bytes:
    """The cursor as an encoded response. Readers at the same place need the same bytes."""
    return pb.SubscribeResponse(cursor=saved_to(saved)).SerializeToString()


def _gap(gap: Gap) -> pb.SubscriptionGap:
    return pb.SubscriptionGap(
        first_seq=gap.first_seq,
        last_seq=gap.last_seq,
        items=gap.items,
        reason=reason_to_message(gap.reason),
        detail=gap.reason.detail,
    )


def _set_unless_done(wakeup: asyncio.Future[bool]) -> None:
    if not wakeup.done():
        wakeup.set_result(False)
