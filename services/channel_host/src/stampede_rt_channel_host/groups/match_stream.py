"""One subscription to matches, at the owner of the channel whose items each get one (paper, section 3.3)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

import grpc

from stampede_rt.errors import IncarnationLost, InvalidArgument, Overloaded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_service_pb2, channel_service_pb2_grpc, time_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.channels.frames import MESSAGE_BYTES_MAX
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.requests import position_of
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscription import WRITE_SECONDS_MAX
from stampede_rt_channel_host.core.group import ChannelTimes, FarTrack, Matched, Matcher, OwnTrack, Track
from stampede_rt_channel_host.groups.frames import matches
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.peers import Dial
from stampede_rt_channel_host.groups.reading import SETTLE_SECONDS_MAX
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.groups.waiting import Waiter

logger = logging.getLogger(__name__)

LIFE_SECONDS = 4.0
MATCHES_PER_MESSAGE_MAX = 64
PAUSE_SECONDS = 0.2


class _FarMember:
    """A member at another host, of which the places are followed by a subscription without payloads."""

    def __init__(self, channel_id: bytes, record_epoch: int, target: str, since: int) -> None:
        self.channel_id = channel_id
        self.epoch = record_epoch
        self.target = target
        self.track = FarTrack()
        self.incarnation = 0
        self.is_followed = False  # from then on nothing that is put is missed
        self.task: asyncio.Task[None] | None = None
        self._since = since
        self._after: tuple[int, int] | None = None
        self._times = ChannelTimes(0, 0)

    def has_passed(self, instant: int) -> bool:
        """By what came on this very subscription: what came before it is on the track."""
        return self._times.has_passed(instant)

    def request(self) -> channel_service_pb2.SubscribeRequest:
        """From a little before the first item that may be matched, or behind what came."""
        request = channel_service_pb2.SubscribeRequest(
            channel_id=self.channel_id, epoch=self.epoch, without_payloads=True
        )
        if self._after is None:
            request.start.CopyFrom(time_pb2.Bound(instant_unix_nano=self._since))
        else:
            request.after.time_unix_nano, request.after.seq = self._after
            request.after.incarnation = self.incarnation
        return request

    def begin_anew(self) -> None:
        """Its host was lost, and seqs of before mean nothing: go on by time."""
        self._after = None
        self._since = self._since if self._times.newest is None else self._times.newest
        self.incarnation = 0

    def take(self, response: channel_service_pb2.SubscribeResponse) -> None:
        """Enter what came."""
        if response.HasField("opened"):
            self.incarnation, self.is_followed = response.opened.incarnation, True
        for delivered in response.runs:
            run = delivered.run
            places = [(time, run.first_seq + at) for at, time in enumerate(run.time_unix_nano)]
            self.track.add(places)
            self._after = max(places, key=lambda place: place[1])
            newest = max(run.time_unix_nano)
            self._times = self._times.merged(ChannelTimes(0, 0, newest))
        if response.progress.HasField("advance_unix_nano"):
            told = ChannelTimes(0, 0, advance=response.progress.advance_unix_nano)
            self._times = self._times.merged(told)


class MatchStream:
    """Serves one stream."""

    def __init__(self, groups: GroupStore, dial: Dial, context: Any, stream: OpenStream) -> None:
        self._groups = groups
        self._dial = dial
        self._context = context
        self._stream = stream
        self._waiter = Waiter()
        self._far: dict[bytes, _FarMember] = {}

    async def run(self, request: pb.SubscribeMatchesRequest) -> None:
        """Until the stream ends. Raises InvalidArgument, StaleBinding, GROUP_NOT_FOUND, Unavailable."""
        if not request.HasField("tolerance_nanos") or request.tolerance_nanos < 0:
            raise InvalidArgument("tolerance_nanos is required and 0 or more: the greatest distance of matched times")
        group = await self._groups.find(request.group_id)
        hosted = self._groups.channels.find(request.per_channel_id, request.epoch)
        if request.per_channel_id not in group.cut.definition.members:
            raise InvalidArgument(f"channel {hosted.record.name} is no member of group {group.record.name}; add it")
        if not await group.reach(None, SETTLE_SECONDS_MAX):
            raise Unavailable(f"group {group.record.name} shows nothing {group.held_by()}; subscribe again")
        group.listeners[self._waiter] = hosted.followers[self._waiter] = None
        try:
            await self._serve(group, hosted, request)
        finally:
            group.listeners.pop(self._waiter, None)
            hosted.followers.pop(self._waiter, None)
            for far in self._far.values():
                if far.task is not None:
                    far.task.cancel()

    async def _serve(self, group: HostedGroup, hosted: HostedChannel, request: pb.SubscribeMatchesRequest) -> None:
        now = self._groups.channels.now()
        after = position_of(request.after) if request.HasField("after") else None
        matcher = Matcher(hosted.channel, {}, request.tolerance_nanos, now, after=after)
        newest = hosted.channel.newest
        begin = after.time if after is not None else now if newest is None else newest
        counted: tuple[int, int] | None = None  # no response yet; the first one says that every member is followed
        while True:  # ends with the stream
            matcher.set_tracks(self._tracks(group, hosted, begin - request.tolerance_nanos))
            found = self._take(matcher, group, hosted, counts=not request.without_payloads)
            holds = counted is not None or all(far.is_followed for far in self._far.values())
            news = bool(found) or (holds and counted != (matcher.unmatched, matcher.dropped))
            if not news and await self._waiter.wait(LIFE_SECONDS):
                continue
            counted = matcher.unmatched, matcher.dropped
            about = pb.SubscribeMatchesResponse(unmatched=matcher.unmatched, dropped=matcher.dropped)
            incarnations = self._incarnations(group)
            await self._write(matches(about, found, incarnations, without_payloads=request.without_payloads))

    def _take(self, matcher: Matcher, group: HostedGroup, hosted: HostedChannel, *, counts: bool) -> list[Matched]:
        """What is settled, about a message of it."""
        has_passed, now, payload_bytes = self._has_passed(group), self._groups.channels.now(), 0
        found: list[Matched] = []
        while payload_bytes < MESSAGE_BYTES_MAX and len(found) < MATCHES_PER_MESSAGE_MAX:
            one = matcher.take(has_passed, now, 1)
            if not one:
                break
            found += one
            items = [one[0].item, *(near.item for near in one[0].matched.values() if near.item is not None)]
            payload_bytes += sum(item.slice.payload_bytes for item in items)
        hosted.count_delivered(payload_bytes if counts else 0)
        return found

    def _has_passed(self, group: HostedGroup) -> Callable[[bytes, int], bool]:
        """Whether a member has; one that is idle is not waited for."""
        now = self._groups.channels.now()
        members = {one.channel_id: one for one in group.cut.members(now)}

        def has_passed(channel_id: bytes, instant: int) -> bool:
            member, far = members.get(channel_id), self._far.get(channel_id)
            if member is None or member.is_idle:
                return True
            if far is not None:
                return far.has_passed(instant)
            return member.heard is not None and member.heard.times.has_passed(instant)

        return has_passed

    def _tracks(self, group: HostedGroup, hosted: HostedChannel, since: int) -> dict[bytes, Track]:
        """Every other member: in this host's memory, or followed at its own."""
        tracks: dict[bytes, Track] = {}
        for channel_id in group.cut.definition.members - {hosted.record.channel_id}:
            own = self._groups.own(channel_id)
            if own is not None:
                self._leave(channel_id)
                tracks[channel_id] = OwnTrack(own.hosted.channel)
            else:
                tracks[channel_id] = self._follow(group, channel_id, since).track
        for channel_id in [one for one in self._far if one not in tracks]:
            self._leave(channel_id)
        return tracks

    def _follow(self, group: HostedGroup, channel_id: bytes, since: int) -> _FarMember:
        record, target = group.channels.get(channel_id), group.targets.get(group.owners.get(channel_id, b""), "")
        epoch = 0 if record is None else record.epoch
        far = self._far.get(channel_id)
        if far is None:
            far = self._far[channel_id] = _FarMember(channel_id, epoch, target, since)
        if epoch:
            far.epoch, far.target = epoch, target or far.target
        if far.task is None or far.task.done():
            far.task = self._stream.spawn(self._keep(far))
        return far

    def _leave(self, channel_id: bytes) -> None:
        far = self._far.pop(channel_id, None)
        if far is not None and far.task is not None:
            far.task.cancel()

    async def _keep(self, far: _FarMember) -> None:
        """Follow a member at its owner; where that fails, again, wherever the directory says it is then."""
        while True:  # paced; ends with the stream, or when the member is left
            if far.target:
                try:
                    await self._listen(far)
                except StampedeError as error:
                    logger.debug("cannot follow a member", extra={"target": far.target, "why": str(error)})
                    if isinstance(error, IncarnationLost):
                        far.begin_anew()
            await asyncio.sleep(PAUSE_SECONDS)

    async def _listen(self, far: _FarMember) -> None:
        channel = self._dial(far.target)
        try:
            call = channel_service_pb2_grpc.ChannelServiceStub(channel).Subscribe(far.request())
            async for response in call:
                far.take(response)
                self._waiter.wake()
        except grpc.RpcError as error:
            raise from_rpc_error(error, far.target) from error
        finally:
            await channel.close(None)

    def _incarnations(self, group: HostedGroup) -> dict[bytes, int]:
        told = {channel_id: record.incarnation for channel_id, record in group.channels.items()}
        return told | {channel_id: far.incarnation for channel_id, far in self._far.items() if far.incarnation}

    async def _write(self, message: bytes) -> None:
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
        except TimeoutError:
            raise Overloaded(
                f"the reader took no match for {WRITE_SECONDS_MAX:g} s, and its subscription is ended; read "
                "faster, and subscribe again behind the last one"
            ) from None
