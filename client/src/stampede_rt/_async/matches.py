"""Matches: an item of one channel with the nearest item of every other member of a group (paper, section 5: stereo)."""

from __future__ import annotations

import functools
from collections import deque
from contextlib import suppress
from types import TracebackType
from typing import Any

from stampede_rt._async.channel import Channel
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.reads import read
from stampede_rt._async.stream_reconnector import StreamReconnector, may_heal
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import GroupNotFound, StampedeError, Unavailable
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.crediting import ITEM_OVERHEAD_BYTES, CreditWindow
from stampede_rt.transports.concurrency_async import StepLock, StepTask, begin_if_blocking, monotonic_s, run_all
from stampede_rt.transports.streams_async import BidiStream
from stampede_rt.v1 import group_service_pb2 as group_pb
from stampede_rt.v1 import item_pb2 as item_pb
from stampede_rt.values.grouping import Matched
from stampede_rt.values.match_rule import MatchRule
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery, Wait
from stampede_rt.values.timeline import DurationLike, Interval, Match, clamp, parse_interval


class MatchSubscription(BoundToProcess):
    """An iterator over `Matched` items (see `Group.match`), and a context manager. `close` ends the iteration.

    The host sends ahead as much as the reader takes in a tenth of a second, and at most 2 MiB. After the loss of a host
    the subscription continues by itself. Each step blocks until the next match. A step raises GroupNotFound when the
    group is deleted, and Unavailable if the client could not reach the host of `per` for the duration `reconnect`. It
    raises IncarnationLost if the group began anew, because all its hosts restarted or were lost, together or one after
    another.

    - `unmatched` counts items of `per` for which a member had no item within the tolerance.
    - `dropped` counts items that retention collected before the host could match them or before a slow reader took
      them. It also counts items of `per` that came so late that the host had already matched later items.
    - `losses` counts how many times the host of `per` was lost with its items.
    """

    def __init__(self, group: GroupMembers, per: Channel, rule: MatchRule, reconnect: DurationLike | None) -> None:
        self._reconnecting = StreamReconnector(group.session, f"the matching of group {group.name!r}", reconnect)
        self._group = group
        self._per = per
        self._rule = rule
        self._stream: BidiStream[group_pb.SubscribeMatchesResponse] | None = None
        self._responses: Any = None
        self._ready: deque[tuple[Matched[Channel], int]] = deque()  # each match with the bytes of credit that it cost
        self._window = CreditWindow()
        self._steps = StepLock()  # callers that step at the same time take turns
        self._step_task = StepTask()
        self._start = rule.start  # where the first stream begins
        self._after: group_pb.MatchCursor | None = None  # where the next stream begins after a break
        # Sums of earlier streams. On each stream the host counts from 0.
        self._unmatched_before = self._dropped_before = 0
        self._closed = False
        self.unmatched = 0
        self.dropped = 0
        self.losses = 0
        begin_if_blocking(self._open)

    @property
    def reconnects(self) -> int:
        """The number of times that the client has opened the subscription again after a break."""
        return self._reconnecting.reconnects

    @property
    def connected(self) -> bool:
        """Whether the subscription is open, as last known. False while the client opens it again, and after its end."""
        return self._reconnecting.connected and not self._closed

    def __repr__(self) -> str:
        state = self._group.session.state or ("closed" if self._closed else "")
        return f"<MatchSubscription of group {self._group.name!r}{f', {state}' if state else ''}>"

    async def __aenter__(self) -> MatchSubscription:
        self._group.session.check_process()
        async with self._steps:
            await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> MatchSubscription:
        return self

    async def __anext__(self) -> Matched[Channel]:
        self._group.session.check_process()
        async with self._steps:
            while not self._closed:
                if self._ready:
                    await self._grant()
                    matched, size = self._ready.popleft()
                    self._window.take(size, monotonic_s())
                    return matched
                await self._step_task.run(self._advance)
            raise StopAsyncIteration

    async def _advance(self) -> None:
        await self._open()
        await self._grant()
        if self._stream is not None and not self._ready:  # there is no stream if `close` was called while it opened
            await self._receive()

    def close(self) -> None:
        """End the subscription.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._group.session.check_thread()
        self._closed = True
        self._reconnecting.stop()
        stream = self._stream
        if stream is not None:
            stream.cancel()

    async def _open(self) -> None:
        """Open the stream to the host of `per`. After a break the stream begins after the last match."""
        if self._stream is not None or self._closed:
            return
        try:
            with span("match", group=self._group.name):
                await self._begin_at_start()
                await self._reconnecting.open(self._open_within)
        except StampedeError as error:
            self._closed = not may_heal(error)
            raise self._group.explained(error) from None

    async def _begin_at_start(self) -> None:
        """Let the first stream begin with the items from `start` on."""
        start = self._start
        if start is None:
            return
        instant: int | None = start.offset
        if start.meta is not None:
            query = ReadQuery(Interval(start, start), match=Match.START, limit=1, payloads=False, wait=Wait(0))
            found = (await read(self._group.session, self._per._state, query)).interval
            instant = None if found is None else found.start  # None: there is no item yet
        if instant is not None:
            before = item_pb.ItemPosition(time_unix_nano=clamp(instant - 1))
            self._after = group_pb.MatchCursor(after=before)
        self._start = None

    async def _open_within(self, timeout_s: float) -> None:
        async def open_at(binding: Binding, _: float) -> None:
            endpoint = self._group.session.endpoints.to(binding.target)
            self._stream = stream = endpoint.open_bidi(endpoint.groups.SubscribeMatches)
            self._window.begin()
            try:
                if self._closed:
                    raise StopAsyncIteration
                await stream.send(group_pb.SubscribeMatchesRequest(open=self._opening(binding.epoch)))
                self._responses = stream.__aiter__()
                # The first response says that the subscription is open.
                await self._take(await self._responses.__anext__())
            except StopAsyncIteration as end:
                self._resume()
                if not self._closed:  # otherwise another part of the program called `close`
                    raise Unavailable(f"the host at {binding.target} ended the stream of matches immediately") from end
            except BaseException:
                self._resume()
                raise

        try:
            await self._group.session.perform(self._per._state, open_at, timeout_s)
        except GroupNotFound:
            await self._group.refresh()  # also looks for the group by its name; raises GroupNotFound if there is none
            await self._group.session.perform(self._per._state, open_at, timeout_s)

    def _opening(self, epoch: int) -> group_pb.SubscribeMatchesOpen:
        return group_pb.SubscribeMatchesOpen(
            group_id=self._group.info.group_id,
            per_channel_id=self._per.info.channel_id,
            epoch=epoch,
            tolerance_nanos=self._rule.tolerance_nanos,
            after=self._after,
            without_payloads=not self._rule.payloads,
            unique=self._rule.unique,
            lateness_nanos=self._rule.lateness_nanos,
        )

    async def _grant(self) -> None:
        """Let the host send as many bytes as the reader has room for."""
        stream = self._stream
        if stream is None or not (credit := self._window.ask(monotonic_s())):
            return
        try:
            with suppress(Unavailable):  # the iteration raises the reason of a broken stream
                await stream.send(group_pb.SubscribeMatchesRequest(credit_bytes=credit))
        except BaseException:  # an interrupt: the credit at the host is unknown
            self._resume()
            raise

    async def _receive(self) -> None:
        try:
            await self._take(await self._responses.__anext__())
        except StopAsyncIteration:
            self._resume()
        except StampedeError as error:
            self._resume()
            self._group.session.check()
            if not may_heal(error):
                self._closed = True
                raise self._group.explained(error) from None
            self._reconnecting.broke()
            self._group.forget_bindings()
        except BaseException:  # an interrupt: the next stream sends these matches again
            self._resume()
            raise

    def _resume(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.cancel()
        self._unmatched_before, self._dropped_before = self.unmatched, self.dropped

    async def _take(self, response: group_pb.SubscribeMatchesResponse) -> None:
        """Add the matches of a response to the ready matches. If the fetch of an item fails, add no match."""
        await self._know_members(response)
        found = await run_all([functools.partial(self._matched, message) for message in response.matches])
        for message, (matched, gone) in zip(response.matches, found, strict=True):
            self._dropped_before += gone
            self._unmatched_before += bool(matched.missing) and not (gone or message.unmatched_channel_ids)
            if self._rule.partial or not matched.missing:
                self._ready.append((matched, _charge(message)))
            else:
                self._window.drop(_charge(message))
        if self._after is not None and self._after.after.incarnation not in (0, response.cursor.after.incarnation):
            self.losses += 1
        self._after = response.cursor
        self.unmatched = self._unmatched_before + response.unmatched
        self.dropped = self._dropped_before + response.dropped

    async def _know_members(self, response: group_pb.SubscribeMatchesResponse) -> None:
        """Ask for the members again if a match names other members. Other processes may have changed the members."""
        known = {channel.info.channel_id for channel in self._group.channels}
        for message in response.matches[-1:]:
            partners = {one.channel_id for one in message.matched} | {*message.unmatched_channel_ids}
            if known != partners | {self._per.info.channel_id}:
                await self._group.refresh()

    async def _matched(self, message: group_pb.ItemMatch) -> tuple[Matched[Channel], int]:
        """Return a match, and the number of its items that retention collected before this client fetched them.

        Fetches the items that the response lacks, because other hosts hold them, in parallel.
        """
        by_id = {channel.info.channel_id: channel for channel in self._group.channels}
        mine = self._per._state.decoder(self._per.incarnation, payloads=self._rule.payloads).decode([message.item])[0]
        others = [one for one in message.matched if one.channel_id in by_id]
        fetched = await run_all([functools.partial(self._item, by_id[one.channel_id], one) for one in others])
        found = {one.channel_id: item for one, item in zip(others, fetched, strict=True) if item is not None}
        found[self._per.info.channel_id] = mine
        missing = [channel for channel in self._group.channels if channel.info.channel_id not in found]
        return Matched(self._group.channels, found, missing=missing, time=mine.time), fetched.count(None)

    async def _item(self, channel: Channel, matched: group_pb.MatchedItem) -> Item | None:
        """Return an item of a match; None if retention has collected the item in the meantime."""
        position = matched.position
        if matched.HasField("item"):
            decoder = channel._state.decoder(position.incarnation, payloads=self._rule.payloads)
            return decoder.decode([matched.item])[0]
        interval = parse_interval(position.time_unix_nano, position.time_unix_nano)
        query = ReadQuery(interval, match=Match.START, payloads=self._rule.payloads, wait=Wait(0))
        items = await read(self._group.session, channel._state, query)
        found = [item for item in items if (item.seq, item.incarnation) == (position.seq, position.incarnation)]
        return found[0] if found else None


def _charge(message: group_pb.ItemMatch) -> int:
    """Return the bytes of credit that a match costs: the sum over all items in the message."""
    runs = [message.item.run, *(one.item.run for one in message.matched if one.HasField("item"))]
    return sum(sum(run.payload_length_bytes) + ITEM_OVERHEAD_BYTES * len(run.payload_length_bytes) for run in runs)
