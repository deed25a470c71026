"""The source's side of the stream that feeds one copy (paper, section 4.1: proxies).

Like a subscription, the stream has a place in the channel instead of a queue. The items that come during one write go
into the next message. The source writes only if something has changed, or if the copy has sent a request meanwhile.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial

from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.fed_copies import FedCopies, FedCopy
from stampede_rt_channel_host.channels.frames import Sendable
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.credit import Credit, requests_of
from stampede_rt_channel_host.copies.ahead_item_sender import AheadItemSender
from stampede_rt_channel_host.copies.fed_items import encode_item, read_answer
from stampede_rt_channel_host.copies.feed_opening import check_feeds, fed_channel, has_others_items
from stampede_rt_channel_host.copies.feed_responses import FeedResponses
from stampede_rt_channel_host.copies.feed_writer import FeedWriter
from stampede_rt_channel_host.copies.messages import opened_to, place_of
from stampede_rt_channel_host.copies.moves.handoff_decision import HandoffDecision
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMove, OutgoingMoves
from stampede_rt_channel_host.core.channel import ChannelCore, ChannelFeed, FeedPart, LagWatch, NewItem
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_runtime.rpc import Context, answer_in_same_turn

SILENT_SECONDS_MAX = 4.0  # the destination of a move sends several requests a second


class FeedStream:
    """Feeds one copy. Observes its channel, on the event loop."""

    def __init__(
        self, store: ChannelStore, context: Context, stream: OpenStream, floors_of: Callable[[bytes], list[CutFloor]],
        moves: OutgoingMoves,
    ) -> None:  # fmt: skip
        """`floors_of` returns the cuts of the groups of a channel that this host owns."""
        self._store = store
        self._responses = FeedResponses(store.now, floors_of)
        self._context = context
        self._stream = stream
        self._wakeup = asyncio.Event()
        self._credit = Credit(self._wakeup.set)
        self._writer = FeedWriter(context, self._credit)
        self._last_received_s = time.monotonic()  # when this host got the last request
        self._held_next_seq = 0  # the copy has reported the items before this seq
        self._send_in_this_turn: Callable[[], bool] | None = None  # while the feed waits for a change, and has no move
        self._is_scheduled = False  # whether the event loop sends the next part to a proxy in its next turn
        self._ahead: AheadItemSender | None = None  # if the copy takes items before the channel stores them
        self._takes_newest = False  # whether the copy is a proxy that understands `encode_item`
        self._failure: Exception | None = None  # an error outside of the feed's task, which ends the feed
        self._source: ChannelCore  # the channel that is fed; set when the feed begins, as `_feed`
        self._feed: ChannelFeed
        self._replication: Replication | None = None  # the replication of the channel, if the copy is a replica
        self._host_id = b""
        self._begins_anew = False
        self._lag = LagWatch()
        self._moves = moves
        self._move: OutgoingMove | None = None
        self._handoff: HandoffDecision | None = None  # the decision about `_move`
        self._opened: pb.FeedOpened | None = None  # goes into the next message
        self._is_handed_over = self._is_released = False  # once handed over, the destination needs only signs of life

    def wake(self) -> None:
        """Send a change of the channel. A replica that has everything else gets it in this turn of the event loop,
        because puts wait for the replica's answer. A proxy gets it in the next turn, with the other changes until then.
        """
        if self._ahead is not None and self._ahead.stored(self._source.next_seq):
            return  # the items that the channel has collected meanwhile leave the replica with the next part
        if self._replication is not None or self._send_in_this_turn is None:
            self._send_or_wake()
        elif not self._is_scheduled:
            self._is_scheduled = True
            asyncio.get_running_loop().call_soon(self._send_or_wake)

    def _send_or_wake(self) -> None:
        """Send the next part, or let the task of the feed do so. Raises nothing, because the host has accepted the
        change: an error ends the feed.
        """
        self._is_scheduled = False
        try:
            is_sent = self._send_in_this_turn is not None and self._send_in_this_turn()
        except Exception as error:  # noqa: BLE001 - the task of the feed raises it
            self._fail(error)
            return
        if not is_sent:
            self._wakeup.set()

    def send_ahead(self, item: NewItem) -> None:
        """Send a run that the channel has accepted and is about to store, if the copy has everything else.

        The copy then stores the run while this host does so. Raises nothing: an error ends the feed.
        """
        ahead = None if self._send_in_this_turn is None or self._wakeup.is_set() else self._ahead
        try:
            write = None if ahead is None else self._free_write()
            if ahead is not None and write is not None and ahead.send(item, write):
                self._writer.spend(item.charge_bytes)
        except Exception as error:  # noqa: BLE001 - as in `_send_or_wake`
            self._fail(error)

    def take_back(self) -> None:
        """See `OwnersFeed`."""
        error = None if self._ahead is None else self._ahead.take_back()
        if error is not None and self._replication is not None:
            self._replication.discard(self._host_id, self)  # no report counts any more
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Let the task of the feed raise the error."""
        self._failure, self._send_in_this_turn = error, None
        self._wakeup.set()

    def end(self, error: StampedeError) -> None:
        """End the feed, because the host no longer serves the channel. The feed of a committed move continues, because
        the destination must still release this host.
        """
        if self._move is None or not self._move.is_committed:
            self._stream.end(error)

    async def run(self, request: pb.FeedRequest) -> bool:
        """Feed the copy until the stream or the move ends. `request` has `open`, which names the copy's host.

        Returns whether the caller may begin another move in this stream. Raises InvalidArgument, StaleBinding, and
        Unavailable if this host is itself a copy that is behind. Raises Overloaded if the channel has too many feeds or
        the copy takes nothing.
        """
        opening = request.open
        hosted = await fed_channel(self._store, self._moves, opening)
        if hosted.fed is None:
            hosted.fed = FedCopies()
        with closing(await self._begin(hosted, opening)) as feed:
            copy = FedCopy(
                opening.host_id,
                opening.target,
                lambda: feed.waiting_items,
                is_replica=self._replication is not None,
            )
            if opening.move_id:
                self._move = self._moves.begin(hosted, opening.host_id, opening.target)
                self._handoff = HandoffDecision(hosted, self._move, feed, when_idle=opening.hand_over_when_idle)
            else:
                check_feeds(hosted)  # other feeds may have begun while this one waited
                hosted.fed.add(copy)
            self._feed = feed
            self._observe(hosted, opening)
            self._take(request, hosted, copy)
            if self._move is None:  # the stream would keep this object beyond the end of a move
                answer_in_same_turn(self._context, partial(self._take_in_same_turn, hosted, copy))
            reading = self._stream.spawn(self._read(hosted, copy))
            try:
                await self._serve(hosted)
                return await self._is_free(opening)
            finally:
                reading.cancel()
                hosted.group_observers.pop(self, None)
                if self._replication is not None:
                    self._replication.discard(opening.host_id, self)
                hosted.fed.discard(copy)
                if self._move is not None:
                    self._move.feed_ended()

    async def _begin(self, hosted: HostedChannel, opening: pb.FeedOpen) -> ChannelFeed:
        """The feed at the copy's place. Replicas and destinations of moves get all accepted items. Other copies get the
        items that readers see. A replica that begins anew waits until the directory's log says that it is not in sync.
        """
        place = place_of(opening.place, hosted.epoch) if opening.HasField("place") else None
        if not opening.owner_facts:
            if not hosted.is_ready:
                raise refusals.not_ready(hosted.record.name)
            self._source = hosted.channel
            follows = hosted.copy is not None and opening.place.owner_epoch >= hosted.epoch
            return ChannelFeed(hosted.channel, place, self._store.now(), follows=follows)
        self._source, self._replication = hosted.core, hosted.replication
        self._begins_anew = place is not None and has_others_items(hosted, opening)
        place = None if self._begins_anew else place
        is_exact, retries = hosted.replication is not None, hosted.puts.retries
        now, takes_puts = self._store.now(), opening.takes_puts
        feed = ChannelFeed(hosted.core, place, now, retries, is_exact=is_exact, takes_puts=takes_puts)
        self._begins_anew |= feed.begins_anew
        holds_nothing = place is None or self._begins_anew
        if self._replication is None or not holds_nothing or await self._replication.begin_anew(opening.host_id):
            return feed
        feed.close()
        raise refusals.not_ready(hosted.record.name)

    def _observe(self, hosted: HostedChannel, opening: pb.FeedOpen) -> None:
        self._host_id = opening.host_id
        if self._replication is None:
            self._takes_newest = opening.takes_runs and not opening.owner_facts and hosted.copy is None
            hosted.group_observers[self] = None
            return
        if opening.takes_items and not opening.move_id:
            self._ahead = AheadItemSender(hosted, self._replication, opening, self._feed, self._responses)
        self._replication.add(opening.host_id, self, refusals.not_ready(hosted.record.name))
        self._replication.report(opening.host_id, self, self._feed.next_seq)

    async def _read(self, hosted: HostedChannel, copy: FedCopy) -> None:
        async for raw in requests_of(self._context.read):
            if not self._take_in_same_turn(hosted, copy, raw):
                raise InvalidArgument("the stream is open already; leave `open` out after the first request")
            if self._is_released:
                return  # the next request may begin another move
        self._credit.end()

    def _take_in_same_turn(
        self, hosted: HostedChannel, copy: FedCopy, raw: bytes | memoryview, _write: object = None
    ) -> bool:
        """Take a request, if possible in the turn of the event loop in which it comes, because puts wait for it.

        Returns False for a request that begins a feed.
        """
        if next_seq := read_answer(raw):
            self._report(next_seq)
            return True
        request: pb.FeedRequest = parse(pb.FeedRequest, bytes(raw), "FeedRequest")
        if request.HasField("open"):
            return False
        self._take(request, hosted, copy)
        self._report(request.held_next_seq)
        return True

    def _report(self, next_seq: int) -> None:
        self._held_next_seq = next_seq
        if self._replication is not None:
            self._replication.receive_report(self._host_id, self, min(next_seq, self._feed.next_seq))

    def _take(self, request: pb.FeedRequest, hosted: HostedChannel, copy: FedCopy) -> None:
        self._responses.heard_nanos, self._last_received_s = request.sent_nanos, time.monotonic()
        self._credit.grant(request.credit_bytes)
        copy.report(request.subscriptions, ready=request.ready)
        if self._move is not None and self._move.step(request):
            self._is_released = True
            self._credit.end()  # ends the feed
        if hosted.fed is not None:
            hosted.fed.relieve(hosted.record.name, copy, hosted.subscriptions)
        if self._responses.owes_sign(hosted) or (self._move is not None and not self._is_handed_over):
            self._wakeup.set()  # a grant of credit wakes the feed anyway

    async def _is_free(self, opening: pb.FeedOpen) -> bool:
        """Whether the move is over, and the caller may begin another one. If so, tells the caller."""
        is_free = self._is_released and opening.another_may_follow
        if is_free:
            await self._writer.write(pb.FeedResponse(move_over=True).SerializeToString())
        return is_free

    async def _greet(self, hosted: HostedChannel) -> None:
        """Tell the copy how the feed begins. In the feed of a move, the first part does so."""
        self._opened = opened_to(self._source.losses, begins_anew=self._feed.begins_anew or self._begins_anew)
        if self._move is None:
            await self._writer.write(self._bare(hosted))

    async def _serve(self, hosted: HostedChannel) -> None:
        await self._greet(hosted)
        while not self._credit.is_final:
            self._wakeup.clear()  # before each wait, so that no change is lost
            await self._writer.turn()
            self._check_destination(hosted)
            now = self._store.now()
            part = None if self._is_handed_over else self._feed.take(now, self._writer.limit_bytes)
            if self._feed.owner_facts is not None:  # a proxy shows its readers its age instead
                self._lag.check(hosted.record.name, self._source.next_seq - self._feed.next_seq, now)
            handoff = None if self._handoff is None else self._handoff.next_handoff(now)
            encoded = self._next_message(hosted, part, handoff)
            # a proxy that has all items needs no second look
            has_all = self._feed.owner_facts is None and part is not None and part.next_seq == self._source.next_seq
            part = None  # frees the runs before the message is written
            if handoff is not None:
                await self._hand_off(encoded)
            elif encoded:
                await self._writer.write(encoded)
            if not encoded or handoff is not None or (has_all and not self._wakeup.is_set()):
                await self._wait_for_change(hosted)

    async def _wait_for_change(self, hosted: HostedChannel) -> None:
        if self._move is None:
            self._send_in_this_turn = partial(self._send_now, hosted)
            try:
                await self._wakeup.wait()
            finally:
                self._send_in_this_turn = None
            if self._failure is not None:
                raise self._failure
            return
        with suppress(TimeoutError):
            async with asyncio.timeout(SILENT_SECONDS_MAX):
                await self._wakeup.wait()

    def _check_destination(self, hosted: HostedChannel) -> None:
        """End the feed of a move whose destination is silent, so that the channel can move to another host."""
        if self._move is not None and time.monotonic() - self._last_received_s > SILENT_SECONDS_MAX:
            raise Unavailable(
                f"the host that takes over channel {hosted.record.name} was silent for {SILENT_SECONDS_MAX:g} s; move "
                "the channel again"
            )

    def _next_message(self, hosted: HostedChannel, part: FeedPart | None, handoff: pb.FeedHandoff | None) -> Sendable:
        """The message that is due; empty if there is none."""
        if part is not None:
            return self._encoded(hosted, part, handoff)
        if handoff is not None or self._opened is not None or self._responses.owes_sign(hosted):
            return self._bare(hosted, handoff)
        return b""

    async def _hand_off(self, encoded: Sendable) -> None:
        """Write the message that hands the channel over."""
        self._is_handed_over = True
        await self._writer.write(encoded)

    def _bare(self, hosted: HostedChannel, handoff: pb.FeedHandoff | None = None) -> bytes:
        opened, self._opened = self._opened, None
        return self._responses.bare(hosted, self._source, self._feed, opened, handoff)

    def _send_now(self, hosted: HostedChannel) -> bool:
        """Send the next part if the copy has all earlier ones, and the transport takes it immediately."""
        write = self._free_write()
        if write is None:
            return False
        limit_bytes = self._writer.limit_bytes
        is_plain = self._takes_newest and not self._responses.owes_facts(hosted)
        fed = self._feed.take_newest(limit_bytes) if is_plain else None
        if fed is not None:
            self._writer.spend(fed.item.charge_bytes)
            write(encode_item(fed))
            return True
        part = self._feed.take(self._store.now(), limit_bytes)
        if part is None:
            return False
        self._lag.stays_behind(0, 0)
        write(self._encoded(hosted, part))
        return part.next_seq == self._source.next_seq

    def _free_write(self) -> Callable[[Sendable], None] | None:
        """Writes in this turn. None if a replica lacks earlier parts, or the next part has to wait."""
        has_all = self._replication is None or self._held_next_seq >= self._feed.next_seq
        return self._writer.write_now if has_all else None

    def _encoded(self, hosted: HostedChannel, part: FeedPart, handoff: pb.FeedHandoff | None = None) -> Sendable:
        """The message with a part, which is written now."""
        opened, self._opened = self._opened, None
        about = self._responses.of(hosted, self._source, part, opened, handoff)
        delivery = hosted.deliveries.encode_once(part.slices, about)
        return self._writer.message(delivery)
