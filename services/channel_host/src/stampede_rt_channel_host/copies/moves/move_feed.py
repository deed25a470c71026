"""The feed of a move, at the destination: first a feed as for any copy, and then the handover by the source."""

from __future__ import annotations

import asyncio
import secrets
import time
from typing import Any

from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.copy_state import CopyState, Inheritance
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.copies.copy_feed import WINDOW_BYTES, CopyFeed
from stampede_rt_channel_host.copies.fed_responses import FedResponse
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.core.channel import FedItem
from stampede_rt_channel_host.core.records import RecordedChannel


class MoveFeed(CopyFeed):
    """The feed of one move, from the owner of a channel to its next owner.

    The future `caught_up` is done as soon as this host has had all items of the source at some moment. The future
    `handoff` is done as soon as this host has all items and facts. From then on `permit` has the owner's
    permit, which the directory checks.
    """

    def __init__(
        self, store: ChannelStore, record: RecordedChannel, state: CopyState, host_id: bytes, target: str,
        bytes_per_second: int = 0, window_bytes: int = WINDOW_BYTES, *, may_hold_early: bool = False,
    ) -> None:  # fmt: skip
        """See `CopyFeed`. `may_hold_early`: if the channel is idle, the source may hold its changes before `hold`."""
        super().__init__(
            store, record, state, host_id, target, bytes_per_second, owner_facts=True, window_bytes=window_bytes
        )
        self.handoff: asyncio.Future[Inheritance] = asyncio.get_running_loop().create_future()
        self.caught_up: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.permit = b""
        self.held_nanos = 0
        """The time at which the changes of the channel began to wait at the source; 0: this host knows of no wait."""
        self._handoff_took_nanos: int | None = None
        self._may_hold_early = may_hold_early
        self._came_nanos = time.monotonic_ns()  # when the latest message came, or this object began to wait for one
        self._step: dict[str, Any] = {}

    @property
    def last_message_seconds(self) -> float:
        """The time from the message before the handoff to the handoff, which took no longer than this.

        If the handoff has not come: the time since the latest message.
        """
        took_nanos = self._handoff_took_nanos
        return (time.monotonic_ns() - self._came_nanos if took_nanos is None else took_nanos) / 1e9

    def hold(self) -> None:
        """Have the source hold all changes, and hand the channel over."""
        self.held_nanos = time.monotonic_ns()
        self._report_step(hold=True)

    def committed(self, epoch: int) -> None:
        """Tell the source that this host is the owner."""
        self._report_step(committed_epoch=epoch)

    def released(self) -> None:
        """Tell the source that nobody needs its items any more."""
        self._report_step(released=True)

    def _report_step(self, **step: Any) -> None:
        self._step |= step
        self._requests.write_soon()

    def _opening(self, source: FeedSource) -> pb.FeedOpen:
        opening = super()._opening(source)
        opening.move_id, opening.another_may_follow = secrets.token_bytes(16), True
        opening.hand_over_when_idle = self._may_hold_early
        return opening

    def _request(self, opening: pb.FeedOpen | None = None, *, grants: bool = True) -> pb.FeedRequest:
        request = super()._request(opening, grants=grants)
        request.MergeFrom(pb.FeedRequest(**self._step))
        request.ready = False  # so that the source sends no readers here before this host is the owner
        return request

    def _take_in_same_turn(self, call: Any, response: FedResponse | FedItem) -> bool:
        """Leave all messages to `_take`: puts wait for an answer of this feed only if this host is a replica."""
        return False

    def _note(self, state: pb.FeedState, charge_bytes: int) -> None:
        """Send no request only to report that the copy has caught up: the request for the next step reports it.

        If the channel has replicas, sends the request: this host may be one of them, and then puts wait for its report.
        """
        was_caught_up = self._state.caught_up
        super()._note(state, charge_bytes)
        if not self._state.caught_up or was_caught_up:
            return
        if not self.caught_up.done():
            self.caught_up.set_result(None)
        if not self._record.policy.replicas:
            self._owes_request = False

    async def _take(self, response: FedResponse | FedItem) -> None:
        assert isinstance(response, FedResponse), "the source of a move sends no items ahead"
        if self.handoff.done():  # the copy has become the owner, or soon will; the rest are signs of life, and the end
            return
        has_handoff = response.fields.state.HasField("handoff")
        before, self._came_nanos = self._came_nanos, time.monotonic_ns()
        if has_handoff:
            self.held_nanos = self.held_nanos or self._came_nanos
            self._handoff_took_nanos = self._came_nanos - before
        await super()._take(response)
        if has_handoff:
            handoff = response.fields.state.handoff
            self.permit = handoff.permit
            self.handoff.set_result(Inheritance(handoff.host_time_unix_nano))
