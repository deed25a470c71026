"""Cut events: the items that become visible at one advance of a group's cut, from all hosts (paper, section 3.3)."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from stampede_rt._async.channel import Channel
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.stream_reconnector import StreamReconnector, may_heal
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import Overloaded, StampedeError, Unavailable
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.retry import OPEN_STREAMS_S, Backoff
from stampede_rt.transports.concurrency_async import StepLock, StepTask, begin_if_blocking, monotonic_s, sleep
from stampede_rt.transports.streams_async import BidiStream
from stampede_rt.v1 import group_service_pb2 as group_pb
from stampede_rt.values.grouping import ByChannel, Cut
from stampede_rt.values.timeline import DurationLike
from stampede_rt.wire.delivered import ItemCount
from stampede_rt.wire.groups import cut_items


class _HostStream:
    """The stream of cut events from one host."""

    def __init__(self, conversation: BidiStream[group_pb.SubscribeCutsResponse]) -> None:
        self.conversation = conversation
        self._responses: Any = conversation.__aiter__()
        self.channel_ids: list[bytes] = []  # the members that the host follows until the stream ends

    async def open(self, request: group_pb.SubscribeCutsOpen) -> group_pb.CutCursor:
        """Open the subscription at this host. Returns the cursor at which the host begins."""
        await self.conversation.send(group_pb.SubscribeCutsRequest(open=request))
        response = await self._responses.__anext__()
        cursor: group_pb.CutCursor = response.opened
        self.channel_ids = [one.channel_id for one in cursor.channels]
        return cursor

    async def event(self, parts: list[group_pb.CutPart]) -> group_pb.CutBoundary:
        """Append this host's parts of the next event to `parts`, until the event ends. Returns its boundary."""
        while True:
            response = await self._responses.__anext__()
            ItemCount().add(one.run for part in response.parts for one in (*part.runs, *part.late_runs))
            parts.extend(response.parts)
            if response.HasField("boundary"):
                boundary: group_pb.CutBoundary = response.boundary
                return boundary


class CutSubscription(BoundToProcess):
    """An iterator over `Cut` events (see `Group.subscribe`), and a context manager. `close` ends the iteration.

    One host decides when an event is due. The other hosts then send their items up to the same cut. After the loss of a
    host, and after a change of the members, the subscription continues after the last event. Each step blocks until
    the next event. A step raises GroupNotFound when the group is deleted, and Unavailable if the client could not reach
    the hosts for the duration `reconnect`. It raises IncarnationLost if the group began anew, because all its hosts
    restarted or were lost, together or one after another.
    """

    def __init__(
        self,
        group: GroupMembers,
        max_wait_nanos: int,
        lateness_nanos: int,
        reconnect: DurationLike | None,
        *,
        payloads: bool,
    ) -> None:
        what = f"the subscription to group {group.name!r}"
        self._reconnecting = StreamReconnector(group.session, what, reconnect)
        self._group = group
        self._max_wait_nanos = max_wait_nanos
        self._lateness_nanos = lateness_nanos
        self._payloads = payloads
        self._streams: list[_HostStream] = []  # the first stream goes to the deciding host
        self._opening_streams: list[_HostStream] = []  # streams that the client is opening
        self._steps = StepLock()  # callers that step at the same time take turns
        self._step_task = StepTask()
        self._ready: Cut[Channel] | None = None  # the next event
        self._cursor: group_pb.CutCursor | None = None  # where the next event begins; None before the first opening
        self._closed = False
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
        return f"<CutSubscription of group {self._group.name!r}{f', {state}' if state else ''}>"

    async def __aenter__(self) -> CutSubscription:
        self._group.session.check_process()
        async with self._steps:
            await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> CutSubscription:
        return self

    async def __anext__(self) -> Cut[Channel]:
        self._group.session.check_process()
        async with self._steps:
            while not self._closed:
                if self._ready is not None:
                    cut, self._ready = self._ready, None
                    return cut
                await self._step_task.run(self._receive)
            raise StopAsyncIteration

    async def _receive(self) -> None:
        """Make the next event ready, or prepare the next streams after a break."""
        try:
            await self._open()
        except StampedeError:
            self._group.session.check()
            raise
        if not self._streams:  # the program called `close` during the opening
            self._group.session.check()
            return
        try:
            parts: list[group_pb.CutPart] = []
            boundary = await self._next_boundary(parts)
            self._ready = self._cut(boundary, parts)
        except StopAsyncIteration:  # the program called `close` meanwhile
            self._cancel_streams()
        except StampedeError as error:
            self._cancel_streams()
            if self._closed:
                return
            self._group.session.check()
            if not may_heal(error):
                self._closed = True
                raise self._group.explained(error) from None
            self._reconnecting.broke()
            self._group.forget_bindings()
        except BaseException:  # an interrupt; the next step reads the interrupted event from its beginning
            self._cancel_streams()
            raise

    def close(self) -> None:
        """End the subscription.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._group.session.check_thread()
        self._closed = True
        self._reconnecting.stop()
        self._cancel_streams()

    def _cancel_streams(self) -> None:
        streams, self._streams, self._opening_streams = [*self._streams, *self._opening_streams], [], []
        for stream in streams:
            stream.conversation.cancel()

    async def _open(self) -> None:
        """Open one stream to each host that owns members. After a break the streams begin after the last event."""
        if self._streams or self._closed:
            return
        try:
            with span("subscribe", group=self._group.name):
                await self._reconnecting.open(self._open_within)
        except StampedeError as error:
            self._closed = not may_heal(error)
            raise self._group.explained(error) from None

    async def _open_within(self, timeout_s: float) -> None:
        backoff = Backoff(monotonic_s() + timeout_s)
        while not self._streams and not self._closed:
            try:
                await self._open_each()
            except StampedeError as error:
                self._cancel_streams()
                if self._closed:
                    return
                if not error.retryable or self._group.session.closed:
                    raise
                if isinstance(error, Overloaded) and error.is_over_open_streams:
                    backoff.end_within(OPEN_STREAMS_S, monotonic_s())
                self._group.forget_bindings()
                delay_s = backoff.next_delay_s(monotonic_s(), 0.5)
                if delay_s is None:
                    raise
                await sleep(delay_s)

    async def _open_each(self) -> None:
        await self._group.refresh()  # other processes may have changed the members
        self._keep_members_only()
        try:
            for target in await self._group.targets():
                endpoint = self._group.session.endpoints.to(target)
                stream = _HostStream(endpoint.open_bidi(endpoint.groups.SubscribeCuts))
                self._opening_streams.append(stream)
                opened = await stream.open(self._opening(decides=len(self._opening_streams) == 1))
                self._cursor = self._cursor or opened
                self._learn(opened)
            self._check_members()
        except StopAsyncIteration:
            raise Unavailable("a host ended the subscription while it began") from None
        except BaseException:
            self._cancel_streams()
            raise
        self._streams, self._opening_streams = self._opening_streams, []
        if self._closed:  # the program called `close` during the opening
            self._cancel_streams()

    def _check_members(self) -> None:
        """Raises Unavailable unless each member is on one stream. A member that moves may be on no stream, or on two.

        An event without a member would take the cursor beyond items that no stream has brought.
        """
        followed = sorted(one for stream in self._opening_streams for one in stream.channel_ids)
        if followed != sorted(channel.info.channel_id for channel in self._group.channels):
            raise Unavailable(
                f"a member of group {self._group.name!r} is moving, and its new host does not serve it yet; try again"
            )

    def _opening(self, *, decides: bool) -> group_pb.SubscribeCutsOpen:
        return group_pb.SubscribeCutsOpen(
            group_id=self._group.info.group_id,
            decides=decides,
            max_wait_nanos=self._max_wait_nanos,
            after=self._cursor,
            without_payloads=not self._payloads,
            spec_version=self._group.info.spec_version,
            lateness_nanos=self._lateness_nanos,
        )

    def _keep_members_only(self) -> None:
        """Forget the cursors of former members. A channel that joins again then begins at the cut of that moment."""
        if self._cursor is not None:
            members = {channel.info.channel_id for channel in self._group.channels}
            kept = [one for one in self._cursor.channels if one.channel_id in members]
            del self._cursor.channels[:]
            self._cursor.channels.extend(kept)

    def _learn(self, opened: group_pb.CutCursor) -> None:
        """Add the channels of one more host to the cursor of this subscription.

        `opened` says with which item that host begins on each of its channels. All hosts begin at the cut of the
        deciding host.
        """
        assert self._cursor is not None
        known = {channel.channel_id for channel in self._cursor.channels}
        self._cursor.channels.extend(one for one in opened.channels if one.channel_id not in known)

    async def _next_boundary(self, parts: list[group_pb.CutPart]) -> group_pb.CutBoundary:
        streams = self._streams
        if not streams:  # the program has called `close`
            raise StopAsyncIteration
        decider, *others = streams
        await decider.conversation.send(group_pb.SubscribeCutsRequest(credit=1))  # the host may send one event
        boundary = await decider.event(parts)
        for stream in others:
            await stream.conversation.send(group_pb.SubscribeCutsRequest(boundary=boundary))
        for stream in others:
            await stream.event(parts)
        return boundary

    def _cut(self, boundary: group_pb.CutBoundary, parts: list[group_pb.CutPart]) -> Cut[Channel]:
        assert self._cursor is not None
        since, channels = self._cursor.cut_unix_nano, self._group.channels
        items, late = {}, {}
        for channel in channels:
            mine = [part for part in parts if part.channel_id == channel.info.channel_id]
            decoder = channel._state.decoder(mine[-1].cursor.incarnation if mine else 0, payloads=self._payloads)
            found = cut_items(mine, decoder, since, boundary.cut_unix_nano)
            items[channel.info.channel_id], late[channel.info.channel_id] = found
        self._advance(boundary, parts)
        incomplete = set(boundary.incomplete_channel_ids)
        return Cut(
            time=boundary.cut_unix_nano,
            items=ByChannel(channels, items),
            late=ByChannel(channels, late),
            incomplete=tuple(channel for channel in channels if channel.info.channel_id in incomplete),
        )

    def _advance(self, boundary: group_pb.CutBoundary, parts: list[group_pb.CutPart]) -> None:
        assert self._cursor is not None
        cursors = {one.channel_id: one for one in self._cursor.channels}
        cursors |= {part.channel_id: part.cursor for part in parts if part.HasField("cursor")}
        self._cursor = group_pb.CutCursor(
            incarnation=boundary.incarnation, cut_unix_nano=boundary.cut_unix_nano, channels=cursors.values()
        )
