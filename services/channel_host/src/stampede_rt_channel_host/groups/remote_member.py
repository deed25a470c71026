"""Follows the times and seqs of the items of a group's member at another host, for a subscription to matches."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc

from stampede_rt.errors import IncarnationLost, StampedeError
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_service_pb2, channel_service_pb2_grpc, time_pb2
from stampede_rt.values.timeline import MAX_INSTANT
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES
from stampede_rt_channel_host.core.group import ChannelTimes, RemoteTrack
from stampede_rt_channel_host.core.group.tracks import TRACK_ITEMS_MAX
from stampede_rt_channel_host.groups.sharing_hosts import Dial

logger = logging.getLogger(__name__)

PAUSE_SECONDS = 0.2
UNANSWERED_SECONDS_MAX = 5.0  # the time that matches wait for an idle member whose host does not answer
AHEAD_ITEMS = TRACK_ITEMS_MAX // 4
"""The member's host may send about this number of keys ahead, so that a large archive does not fill the track."""


class RemoteMember:
    """One member at another host.

    `track` holds the keys of the member's items. `epoch` is the member's epoch, and `target` the address of its host,
    as the directory last returned them. `incarnation` is the member's incarnation, 0 while it is unknown. As soon as
    `is_followed` is True, `track` gets the key of every item that producers put.
    """

    def __init__(self, channel_id: bytes, since: int) -> None:
        """`since`: the time at which the subscription starts, a little before the first item that may match."""
        self.channel_id = channel_id
        self.epoch = 0
        self.target = ""
        self.track = RemoteTrack()
        self.incarnation = 0
        self.is_followed = False
        self._since = since
        self._cursor: channel_service_pb2.SubscriptionCursor | None = None  # the last one received; None: none yet
        self._times = ChannelTimes(0, 0)  # the newest item and the advance, by the messages of this subscription
        self._credit = 0  # the granted bytes that the member's host has not used yet
        self._item_bytes = ITEM_OVERHEAD_BYTES  # the least that an item of the last run has cost
        self._wants_more = asyncio.Event()
        self._had_all = False  # the track once had all items that the member had
        self._begun_s = asyncio.get_running_loop().time()

    def has_passed(self, instant: int, lateness_nanos: int, *, is_idle: bool) -> bool:
        """Whether the member has passed the instant, judged only by the messages of this subscription.

        The messages come in order. So the track already has all items that the member got before it passed the instant.
        If the member has not passed the instant, this method lets its host send more. An idle member (`is_idle`) has
        passed each instant as soon as the track has had all of its items, which may come from an archive.
        """
        passed = self._times.has_passed(instant, lateness_nanos) or (is_idle and not self._owes_items)
        if self._credit <= 0 or not passed:
            self._ask_for_more(must=not passed)
        return passed

    @property
    def _owes_items(self) -> bool:
        """Whether earlier items of the member may still come.

        False if the member's host has not answered for a while.
        """
        waited_s = asyncio.get_running_loop().time() - self._begun_s
        return not self._had_all and (self.is_followed or waited_s < UNANSWERED_SECONDS_MAX)

    def _ask_for_more(self, *, must: bool) -> None:
        """Let the member's host send more, if the track has room or the matches cannot continue without it."""
        if self._credit * 2 < self._ahead_bytes and (must or len(self.track) < 2 * AHEAD_ITEMS):
            self._wants_more.set()

    @property
    def _ahead_bytes(self) -> int:
        return AHEAD_ITEMS * self._item_bytes

    async def keep(self, dial: Dial, on_change: Callable[[], None]) -> None:
        """Follow the member at its owner. If that fails, try again at the host that the directory then names."""
        while True:  # paced by the sleep; ends by cancellation
            if self.target:
                try:
                    await self._listen(dial, on_change)
                except StampedeError as error:
                    logger.debug(
                        "cannot follow a member",
                        extra={"event": "group_member_unreachable", "target": self.target, "why": str(error)},
                    )
                    if isinstance(error, IncarnationLost):
                        self._begin_anew()
            await asyncio.sleep(PAUSE_SECONDS)

    async def _listen(self, dial: Dial, on_change: Callable[[], None]) -> None:
        target = self.target
        channel = dial(target)
        call: Any = channel_service_pb2_grpc.ChannelServiceStub(channel).Subscribe()
        asking = asyncio.create_task(self._ask(call), name="requests to a member")
        try:
            async for response in call:
                self._take(response)
                on_change()
        except grpc.RpcError as error:
            raise from_rpc_error(error, target) from error
        finally:
            asking.cancel()  # gRPC leaves the task of an iterator of requests behind if the other side ends the call
            await asyncio.gather(asking, return_exceptions=True)
            await channel.close(None)

    async def _ask(self, call: Any) -> None:
        """Send the requests. If a write fails, the call is over, and its reader gets the reason."""
        async for request in self._requests():
            await call.write(request)

    async def _requests(self) -> AsyncIterator[channel_service_pb2.SubscribeRequest]:
        """Yield the request that opens the subscription, and then requests with credit.

        The subscription begins at `since`, or after the items that came already. The host charges each item with its
        payload, although it does not send the payload. So the credit grows with the size of the items.
        """
        opening = channel_service_pb2.SubscribeOpen(channel_id=self.channel_id, epoch=self.epoch, without_payloads=True)
        if self._cursor is None:
            opening.start.CopyFrom(time_pb2.Bound(instant_unix_nano=self._since))
        else:
            opening.cursor.CopyFrom(self._cursor)
        self._credit = self._ahead_bytes
        yield channel_service_pb2.SubscribeRequest(open=opening, credit_bytes=self._credit)
        while True:  # `_listen` ends it
            await self._wants_more.wait()
            self._wants_more.clear()
            granted = self._ahead_bytes - self._credit
            if granted > 0:
                self._credit += granted
                yield channel_service_pb2.SubscribeRequest(credit_bytes=granted)

    def _begin_anew(self) -> None:
        """Forget all seqs and keys, and follow the member again from the time of its newest item.

        The member's host was lost together with its items, so the seqs of the former incarnation are no longer valid.
        """
        self.track.forget_before(MAX_INSTANT)
        self._cursor = None
        self._since = self._since if self._times.newest is None else self._times.newest
        self.incarnation = 0

    def _take(self, response: channel_service_pb2.SubscribeResponse) -> None:
        if response.HasField("opened"):
            self.incarnation, self.is_followed = response.opened.incarnation, True
        for delivered in response.runs:
            run = delivered.run
            keys = [(time, run.first_seq + at) for at, time in enumerate(run.time_unix_nano)]
            self.track.add(keys)
            lengths = run.payload_length_bytes
            self._credit -= sum(lengths) + ITEM_OVERHEAD_BYTES * len(lengths)
            self._item_bytes = ITEM_OVERHEAD_BYTES + min(lengths, default=0)
            self._times = self._times.merged(ChannelTimes(0, 0, max(run.time_unix_nano)))
        # a response has only progress if there is credit, and nothing else to send
        self._had_all |= response.HasField("progress") and not (response.runs or response.HasField("gap"))
        self._ask_for_more(must=False)
        if response.HasField("cursor"):
            self._cursor = response.cursor
        if response.progress.HasField("advance_unix_nano"):
            reported = ChannelTimes(0, 0, advance=response.progress.advance_unix_nano)
            self._times = self._times.merged(reported)
