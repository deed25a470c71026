"""One subscription to cut events at one host (paper, section 3.3, Figure 7; decision 0011).

One host decides when an event is due. It ends each event with a boundary. The reader passes the boundary to the other
hosts. Each of them waits until its own cut has reached the boundary, and answers with the items of its own channels.
"""

from __future__ import annotations

import asyncio
from collections import deque

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt.values.timeline import clamp
from stampede_rt.wire.reads import reason_to_message
from stampede_rt_channel_host.channels.frames import MESSAGE_BYTES_MAX
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.credit import Credit, requests_of
from stampede_rt_channel_host.channels.subscriptions.reader_drops import ReaderDrops
from stampede_rt_channel_host.core.group import MAX_WAIT_NANOS_DEFAULT, Boundary, CutFollower, EventDecider, Loss
from stampede_rt_channel_host.groups.frames import cut_part
from stampede_rt_channel_host.groups.hosted_group import NOTHING_VISIBLE, HostedGroup, other_incarnation
from stampede_rt_channel_host.groups.reading import SETTLE_SECONDS_MAX
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.groups.waiting import Waiter
from stampede_rt_channel_host.groups.writing import EventWriter
from stampede_rt_runtime.access.control import check_access
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context

BOUNDARIES_MAX = 256  # the most boundaries that the host has received and not answered yet
_TIMER_SECONDS_MIN = 0.0001


class _FollowedMember:
    """A member at this host: the channel, and the subscription's place in the channel."""

    def __init__(self, hosted: HostedChannel, follower: CutFollower) -> None:
        self.hosted = hosted
        self.follower = follower

    def cursor(self) -> pb.ChannelCursor:
        record = self.hosted.record
        return pb.ChannelCursor(
            channel_id=record.channel_id, incarnation=record.incarnation, next_seq=self.follower.next_seq
        )


class CutEvents:
    """Serves one stream."""

    def __init__(self, groups: GroupStore, context: Context, stream: OpenStream) -> None:
        self._groups = groups
        self._context = context
        self._stream = stream
        self._writer = EventWriter(context, "cut event")
        self._waiter = Waiter()
        self._generation = 0  # the group's generation as of the last look
        self._incarnation = 0  # the group's, at the beginning of the subscription
        self._spec_version = 0  # the group's, at the beginning of the subscription
        self._followed: dict[bytes, _FollowedMember] = {}
        # the reader's cursors at the opening; None after the subscription has begun
        self._kept: dict[bytes, pb.ChannelCursor] | None = {}
        self._boundaries: deque[Boundary] = deque()  # received and not answered yet
        self._credit = Credit(self._waiter.wake)  # counts events; not used if another host decides
        self._room = asyncio.Event()  # set while there is room for another boundary
        self._cut: int | None = None  # the cut of the last event
        self._drops = ReaderDrops("", "")  # `run` enters it in the host's table

    async def run(self) -> None:
        """Serve until the stream ends, or until the reader has closed its side and has got everything that it asked
        for.

        Raises InvalidArgument, GROUP_NOT_FOUND, IncarnationLost if the group began anew, StaleBinding if a member has
        left the host, and Overloaded if the reader is too slow. Raises Unavailable if this host does not learn the cut
        in time, or if the group has other members now.
        """
        request = await self._context.read()
        if not isinstance(request, pb.SubscribeCutsRequest) or not request.HasField("open"):
            raise InvalidArgument("the first request of a subscription to cuts has no open; send it before boundaries")
        opening = request.open
        if opening.lateness_nanos < 0:
            raise InvalidArgument(f"lateness_nanos is {opening.lateness_nanos}; it is a time to wait: give 0 or more")
        self._credit.grant(request.credit)
        self._groups.check_serving()
        group = await self._groups.find(opening.group_id, opening.spec_version)
        await self._writer.turn()  # many streams may have waited for the same group
        check_access(AccessVerb.READ, AccessKind.GROUP, group.record.name)
        await self._begin(group, opening)
        self._groups.observe(group, self._waiter, of_members=opening.decides)
        reading = self._stream.spawn(self._read(group, decides=opening.decides))
        try:
            await self._writer.write(pb.SubscribeCutsResponse(opened=self._opened(group)).SerializeToString())
            with self._groups.channels.readers.reading(group.record.name, of_group=True) as self._drops:
                await self._serve(group, opening)
        finally:
            reading.cancel()
            self._groups.stop_observing(group, self._waiter)
            for followed in self._followed.values():
                followed.hosted.group_readers.pop(self, None)
                self._groups.channels.scheduler.begin(followed.follower.emptying())

    async def _begin(self, group: HostedGroup, opening: pb.SubscribeCutsOpen) -> None:
        """Begin at the present cut, or at the cursor of the reader."""
        resumes = opening.HasField("after")
        kept = opening.after.cut_unix_nano if resumes else NOTHING_VISIBLE
        floor = None if kept == NOTHING_VISIBLE else kept
        if resumes and opening.after.incarnation != group.record.incarnation:
            raise other_incarnation(group.record)
        if not await group.reach(floor, SETTLE_SECONDS_MAX):
            raise Unavailable(
                f"group {group.record.name} has not reached the reader's position yet, {group.held_by()}; try again"
            )
        await self._writer.turn()
        self._cut = floor if resumes else group.cut.cut
        self._incarnation = group.record.incarnation
        self._kept = {one.channel_id: one for one in opening.after.channels}
        self._spec_version = opening.spec_version or group.record.spec_version
        self._follow(group)
        self._kept = None

    def _opened(self, group: HostedGroup) -> pb.CutCursor:
        return pb.CutCursor(
            incarnation=group.record.incarnation,
            cut_unix_nano=NOTHING_VISIBLE if self._cut is None else self._cut,
            channels=[one.cursor() for one in self._followed.values()],
        )

    def _follow(self, group: HostedGroup) -> None:
        """Follow the members at this host, also members that came back to it.

        Raises StaleBinding if a followed member has left the host. Raises Unavailable if the group has other members
        now, or if another member has come to this host: this host does not know which of its items the reader has.
        The reader must subscribe again, after its last event.
        """
        if group.generation == self._generation:
            return
        self._generation = group.generation
        group.check_incarnation(self._incarnation)
        if group.record.spec_version != self._spec_version:
            raise Unavailable(
                f"group {group.record.name} has other members now; subscribe at all their hosts, after the last event"
            )
        for channel_id in sorted(group.cut.definition.members):
            own, held = self._groups.own(channel_id), self._followed.get(channel_id)
            if held is not None and own is None:
                raise self._groups.not_here(channel_id)
            if own is not None and (held is None or held.hosted is not own.hosted):
                self._take_up(own.hosted, held)

    def _take_up(self, hosted: HostedChannel, held: _FollowedMember | None) -> None:
        channel_id = hosted.record.channel_id
        cursor = self._kept_cursor(hosted) if held is None else held.cursor()
        follower = CutFollower(
            hosted.channel,
            self._cut,
            self._groups.channels.now(),
            next_seq=None if cursor is None else cursor.next_seq,
            incarnation=None if cursor is None else cursor.incarnation,
        )
        if held is not None:
            held.hosted.group_readers.pop(self, None)
        hosted.group_readers[self] = None
        self._followed[channel_id] = _FollowedMember(hosted, follower)

    def _kept_cursor(self, hosted: HostedChannel) -> pb.ChannelCursor | None:
        """The reader's cursor of a channel, None if it has none.

        Raises Unavailable after the subscription has begun.
        """
        if self._kept is None:
            raise Unavailable(
                f"channel {hosted.record.name} has come to this host; subscribe again at the hosts of all members, "
                "after the last event"
            )
        return self._kept.get(hosted.record.channel_id)

    async def _read(self, group: HostedGroup, *, decides: bool) -> None:
        """Read requests: credit, or the boundaries that another host decided."""
        async for request in requests_of(self._context.read):
            if request.HasField("open") or request.HasField("boundary") == decides:
                raise InvalidArgument(
                    "the request does not fit the subscription; after `open`, send credit to the host that decides, "
                    "and one boundary in each request to the other hosts"
                )
            if decides:
                self._credit.grant(request.credit)
                continue
            boundary = request.boundary
            last = self._boundaries[-1].cut if self._boundaries else self._cut
            if boundary.incarnation != group.record.incarnation or (last is not None and boundary.cut_unix_nano < last):
                raise InvalidArgument(
                    "a boundary lies before the last one, or is of another incarnation; pass on each "
                    "boundary of the deciding host as it is"
                )
            while len(self._boundaries) >= BOUNDARIES_MAX:
                self._room.clear()
                await self._room.wait()
            self._boundaries.append(Boundary(boundary.cut_unix_nano, tuple(boundary.incomplete_channel_ids)))
            self._waiter.wake()
        self._credit.end()

    async def _serve(self, group: HostedGroup, opening: pb.SubscribeCutsOpen) -> None:
        max_wait = opening.max_wait_nanos if opening.HasField("max_wait_nanos") else MAX_WAIT_NANOS_DEFAULT
        decider = EventDecider(self._cut, max_wait, opening.lateness_nanos) if opening.decides else None
        while not self._is_over(decider):
            await self._writer.turn()
            self._follow(group)
            boundary = self._due_boundary(group, decider) if decider is not None else self._next_boundary(group)
            wanted = self._credit.amount_left > 0 or bool(self._boundaries)
            if boundary is not None:
                if decider is not None:
                    self._credit.spend(1)
                await self._send_event(group, boundary, without_payloads=opening.without_payloads)
            elif not wanted:
                await self._waiter.wait(None)
            elif self._writer.silence_left_s <= 0:
                await self._writer.write(pb.SubscribeCutsResponse().SerializeToString())
            else:
                await self._waiter.wait(self._pause_s(decider))

    def _is_over(self, decider: EventDecider | None) -> bool:
        """Whether the reader has closed its side, and has got everything that it asked for."""
        return self._credit.is_final and not self._boundaries and (decider is None or self._credit.amount_left <= 0)

    def _due_boundary(self, group: HostedGroup, decider: EventDecider) -> Boundary | None:
        """The boundary of the event that is due. None without credit: the cuts that come meanwhile make one event."""
        now = self._groups.channels.now()
        decider.note(group.cut.cut, now)
        if decider.wake_at() is None or self._credit.amount_left <= 0:
            return None
        return decider.due(group.members(), now)

    def _next_boundary(self, group: HostedGroup) -> Boundary | None:
        """The next boundary from the reader, as soon as this host's cut has reached it.

        The boundary itself raises no cut.
        """
        if not self._boundaries or not group.has_reached(self._boundaries[0].cut):
            return None
        self._room.set()
        return self._boundaries.popleft()

    def _pause_s(self, decider: EventDecider | None) -> float:
        due = None if decider is None else decider.wake_at()
        left_s = max(self._writer.silence_left_s, 0.0)
        if due is None:
            return left_s
        return min(left_s, max((due - self._groups.channels.now()) / 1e9, _TIMER_SECONDS_MIN))

    async def _send_event(self, group: HostedGroup, boundary: Boundary, *, without_payloads: bool) -> None:
        for followed in list(self._followed.values()):
            await self._send_part(followed, boundary.cut, without_payloads=without_payloads)
        self._cut = boundary.cut
        end = pb.CutBoundary(
            cut_unix_nano=boundary.cut,
            incarnation=group.record.incarnation,
            incomplete_channel_ids=boundary.incomplete,
        )
        await self._writer.write(pb.SubscribeCutsResponse(boundary=end).SerializeToString())

    async def _send_part(self, followed: _FollowedMember, cut: int, *, without_payloads: bool) -> None:
        follower = followed.follower
        follower.begin(cut)
        while follower.under_way:
            await self._writer.turn()
            step = follower.take(self._groups.channels.now(), MESSAGE_BYTES_MAX)
            if not step.is_last and not step.late and not step.slices:
                await asyncio.sleep(0)  # there is much to look at: let other tasks run first
                continue
            about = pb.CutPart(channel_id=followed.hosted.record.channel_id)
            if step.loss is not None:
                about.loss.CopyFrom(loss_message(step.loss))
                self._drops.count(self._drops.collected + step.loss.items, 0)
            if step.is_last:
                about.cursor.CopyFrom(followed.cursor())
            await self._writer.write(cut_part(about, step.slices, step.late, without_payloads=without_payloads))
            if not without_payloads:
                parts = [one.slice for one in step.slices + step.late]
                followed.hosted.count_delivered(
                    sum(one.items for one in parts), sum(one.payload_bytes for one in parts)
                )


def loss_message(loss: Loss) -> pb.CutLoss:
    """The message of a loss. Its `before` is at most the greatest instant, even if an overlap puts it later."""
    return pb.CutLoss(
        before_unix_nano=clamp(loss.before),
        items=loss.items if loss.is_exact else None,
        reason=reason_to_message(loss.reason),
        detail=loss.reason.detail,
    )
