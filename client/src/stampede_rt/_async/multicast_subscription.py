"""Subscriptions whose items come from UDP multicast (paper, section 4.1: multicast by a callback action).

The stream to the host stays open. It brings all items until the reader receives the datagrams, and after that the items
that no datagram brings. It always brings everything else: gaps, losses, moves, the end of the channel.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.session import Session
from stampede_rt._async.stream_reconnector import StreamReconnector
from stampede_rt._async.subscription import Subscription
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.multicast.encryption import DatagramOpener, Verifier
from stampede_rt.multicast.multicast_receiver import MulticastReceiver
from stampede_rt.multicast.repair_pace import BEAT_S_MAX, RepairStep
from stampede_rt.pacing.crediting import ITEM_OVERHEAD_BYTES
from stampede_rt.transports.concurrency_async import in_thread, monotonic_s, sleep
from stampede_rt.transports.multicast_async import GroupSocket
from stampede_rt.transports.multicast_joining import join_group
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.model import Item
from stampede_rt.values.statistics import MulticastStats
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.long_answers import LongRun

_log = logging.getLogger("stampede_rt")

# If datagrams do not reach this reader, it stops using multicast for this time. The time doubles with each failure.
RETRY_PAUSE_S = 60.0
RETRY_PAUSE_S_MAX = 3600.0
REPAIR_BYTES_MAX = 2**18  # the most bytes of items that one repair asks for, without the last item
COUNTS = ("datagrams", "items", "repairs", "repeated", "forged", "foreign", "other_key")


class MulticastSubscription(Subscription):
    """A subscription with `via="multicast"`. Its steps give the items that an ordinary subscription gives, in the same
    order."""

    def __init__(
        self, session: Session, state: ChannelState, opening: channel_pb.SubscribeOpen, reconnecting: StreamReconnector
    ) -> None:
        if opening.mode != channel_pb.SUBSCRIBE_MODE_ALL or opening.without_payloads or opening.HasField("group_id"):
            raise InvalidArgument(
                'via="multicast" brings all items with their payloads, and without a group; leave `mode` and '
                "`payloads` out, or leave `via` out"
            )
        super().__init__(session, state, opening, reconnecting)
        self._offer = channel_pb.MulticastOffer()
        self._socket: GroupSocket | None = None
        self._receiving: MulticastReceiver | None = None
        self._is_following = False  # whether the items come from datagrams
        self._repair_seq = 0  # the seq that the open repair asks for; 0: no repair is open
        self._no_multicast_before_s, self._retry_pause_s = 0.0, RETRY_PAUSE_S
        self._item_bytes = 1.0  # about the bytes of one item
        self._before = MulticastStats()  # the counts of earlier streams

    @property
    def multicast(self) -> MulticastStats:
        """Whether the items come in datagrams, and the counts of datagrams so far."""
        receiving = self._receiving
        if receiving is None:
            return self._before
        now = receiving.stats(self._offer.group, following=self._is_following)
        return replace(now, **{name: getattr(now, name) + getattr(self._before, name) for name in COUNTS})

    async def _advance(self) -> None:
        if self._stream is not None and not self._opening.multicast and monotonic_s() >= self._no_multicast_before_s:
            self._reopen()  # try multicast again
        await self._open()
        receiving, socket = self._receiving, self._socket
        if receiving is not None and socket is not None and self._is_following:
            await self._follow(receiving, socket)
            return
        await self._grant()
        if not self._ready:
            await self._receive()
        if receiving is not None and socket is not None and self._receiving is receiving:
            await self._check_datagrams(receiving, socket)

    async def _open_stream(self, binding: Binding) -> None:
        self._opening.multicast = monotonic_s() >= self._no_multicast_before_s
        self._offer = channel_pb.MulticastOffer()
        await super()._open_stream(binding)
        if self._offer.stream_id:
            await self._join(binding.target)

    async def _join(self, target: str) -> None:
        """Join the group. If this machine cannot, continue without multicast."""
        offer = self._offer
        try:
            opener = DatagramOpener(offer.stream_id, offer.key_number, offer.key)
            verifier = Verifier(offer.stream_id, offer.public_key)
            joined = await in_thread(lambda: join_group(offer.group, target))
        except (OSError, ValueError, StampedeError) as error:
            _log.info("the subscription to channel %r does not use multicast: %s", self._state.info.name, error)
            self._leave()
            return
        except BaseException:  # the step is cancelled: without another stream the client would not receive datagrams
            self._reopen()
            raise
        assert self._decoder is not None, "the stream is open"
        self._socket = GroupSocket(joined)
        self._receiving = MulticastReceiver(opener, verifier, monotonic_s(), partial(_decoded, self._decoder))
        if self._closed:  # the program called `close` meanwhile
            self._socket.close()

    async def _check_datagrams(self, receiving: MulticastReceiver, socket: GroupSocket) -> None:
        """While the stream brings the items: check whether the datagrams bring the next items. If they do, take the
        items from the datagrams from now on."""
        cursor = self._cursor
        if cursor is None or cursor.HasField("from_unix_nano"):  # items that the host held at the start come first
            return
        receiving.merge.pass_to(cursor.next_seq)
        now_s = monotonic_s()
        receiving.take_datagrams(socket.poll(), now_s)
        if receiving.has_received and receiving.merge.is_contiguous:
            self._is_following = True
            await self._repair(receiving)  # from now on the host sends only requested items
        elif receiving.pace.next_step(now_s, is_missing=False)[0] is RepairStep.LEAVE:
            self._leave()

    async def _follow(self, receiving: MulticastReceiver, socket: GroupSocket) -> None:
        """Take the next datagrams, wait for some, or ask the host for the items that are missing."""
        now_s = monotonic_s()
        if self._session.closed:  # a step must read the stream again: this raises the error
            self._reopen()
            return
        receiving.pace.note_look(now_s)
        if items := receiving.take(socket.poll(), now_s):
            self._add(items, receiving)
            await sleep(0)  # if datagrams come faster than the program takes them, other tasks have turns, too
            return
        step, wait_s = receiving.pace.next_step(now_s, is_missing=receiving.merge.is_missing)
        if step is RepairStep.LEAVE:
            await self._repair(receiving)
            if self._receiving is not receiving:  # the host no longer serves the channel
                return
            _log.info("the datagrams of channel %r do not come any more", self._state.info.name)
            self._leave()
        elif step is RepairStep.REOPEN:
            self._reopen()
        elif step is RepairStep.REPAIR:
            await self._repair(receiving)
        else:
            await socket.wait(min(wait_s, BEAT_S_MAX))

    async def _repair(self, receiving: MulticastReceiver) -> None:
        """Ask the host for the first missing items, and wait for its answer."""
        stream, self._repair_seq = self._stream, receiving.merge.next_seq
        wanted = min(receiving.merge.missing_items * self._item_bytes, REPAIR_BYTES_MAX)
        request = channel_pb.SubscribeRequest(repair_next_seq=self._repair_seq, credit_bytes=max(1, int(wanted)))
        if stream is not None:
            with suppress(Unavailable):  # the next response raises the error of a broken stream
                await stream.send(request)
        try:
            while self._repair_seq and self._receiving is receiving and not self._closed:
                await self._receive()
        except BaseException:  # a cancelled step ends the stream, and a reader of datagrams would not notice this
            self._reopen()
            raise
        receiving.pace.note_request()

    def _add(self, items: Sequence[Item], receiving: MulticastReceiver) -> None:
        """Give the items to the reader next, and note the place after them."""
        self._ready.add((items,))
        self._note_size(items)
        if self._cursor is not None:
            incarnation, next_seq = self._cursor.incarnation, receiving.merge.next_seq
            self._cursor = channel_pb.SubscriptionCursor(incarnation=incarnation, next_seq=next_seq)

    def _note_size(self, items: Sequence[Item]) -> None:
        if items:
            self._item_bytes += (items[-1].payload_length_bytes + ITEM_OVERHEAD_BYTES - self._item_bytes) / 8

    def _take(self, response: channel_pb.SubscribeResponse, runs: Sequence[LongRun]) -> None:
        if response.HasField("multicast"):
            self._take_offer(response.multicast)
        receiving = self._receiving
        if receiving is None or not self._is_following:
            super()._take(response, runs)
            return
        if response.gap.items:
            self._take_gap(response.gap, receiving)
        super()._take(response, runs)
        if response.HasField("cursor"):
            receiving.merge.pass_to(response.cursor.next_seq)
        self._add(receiving.merge.take(), receiving)
        if response.repair_next_seq == self._repair_seq:
            self._repair_seq = 0

    def _take_gap(self, gap: channel_pb.SubscriptionGap, receiving: MulticastReceiver) -> None:
        """Take the held items up to the end of the gap. The gap then counts only items that the reader did not get."""
        merge, end_seq = receiving.merge, gap.last_seq + 1
        new = end_seq - max(gap.first_seq, merge.next_seq)  # the host may have reported a part of the gap before
        held = merge.take_up_to(end_seq)
        had = sum(gap.first_seq <= item.seq < end_seq for item in held)  # items that came before retention took them
        gap.items = max(0, min(gap.items, new) - had)
        self._ready.add((held,))

    def _take_offer(self, offer: channel_pb.MulticastOffer) -> None:
        self._offer = offer
        if self._receiving is not None:
            self._receiving.opener = DatagramOpener(offer.stream_id, offer.key_number, offer.key)

    def _unseen(self, runs: list[Sequence[Item]]) -> Sequence[Sequence[Item]]:
        if self._receiving is None or not self._is_following:
            return super()._unseen(runs)
        new = self._receiving.merge.fill([item for run in runs for item in run])
        self._note_size(new)
        return (new,)

    def _took_all(self, last_bytes: int) -> None:
        if self._is_following:  # the host sends the items in datagrams, and needs no credit for them
            self._ready_bytes = 0
        else:
            super()._took_all(last_bytes)

    def _resume(self) -> None:
        self._stop_receiving()
        super()._resume()

    def _leave(self) -> None:
        """Continue on another stream, without multicast for a time."""
        self._no_multicast_before_s = monotonic_s() + self._retry_pause_s
        self._retry_pause_s = min(2 * self._retry_pause_s, RETRY_PAUSE_S_MAX)
        self._reopen()

    def _reopen(self) -> None:
        """Continue on another stream, at the present host of the channel."""
        if self._stream is not None:
            self._stream.cancel()
        self._resume()

    def _stop_receiving(self) -> None:
        self._before = replace(self.multicast, following=False)
        socket, self._socket, self._receiving = self._socket, None, None
        self._is_following, self._repair_seq = False, 0
        if socket is not None:
            socket.close()

    def close(self) -> None:
        """See `Subscription.close`."""
        super().close()
        socket: Any = self._socket
        if socket is not None:
            socket.close()


def _decoded(decoder: ItemDecoder, body: bytes) -> Sequence[Item]:
    """The items of a message. This is no method, because the subscription would then reference itself, and would not
    end when the program drops it."""
    response = channel_pb.SubscribeResponse.FromString(body)
    return [item for run in decoder.decode_each(response.runs) for item in run]
