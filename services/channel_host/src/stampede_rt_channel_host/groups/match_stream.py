"""Serves one subscription to matches, at the owner of the matched channel (paper, section 3.3)."""

from __future__ import annotations

import asyncio

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.values.timeline import Bound
from stampede_rt_channel_host.channels.frames import MESSAGE_BYTES_MAX
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.requests import position_of, position_to
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.credit import Credit, requests_of
from stampede_rt_channel_host.channels.subscriptions.reader_drops import ReaderDrops
from stampede_rt_channel_host.core.group import (
    OWN,
    FoundMatch,
    ItemsNotLoaded,
    LocalTrack,
    Matcher,
    RecordedOwnTrack,
    RecordedTrack,
    Track,
)
from stampede_rt_channel_host.groups.frames import matches
from stampede_rt_channel_host.groups.hosted_group import HostedGroup, other_incarnation
from stampede_rt_channel_host.groups.reading import SETTLE_SECONDS_MAX, member_of
from stampede_rt_channel_host.groups.recorded_matches import filled, load
from stampede_rt_channel_host.groups.remote_member import RemoteMember
from stampede_rt_channel_host.groups.sharing_hosts import Dial
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.groups.waiting import Waiter
from stampede_rt_channel_host.groups.writing import EventWriter
from stampede_rt_runtime.access.control import check_access
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context

MATCHES_PER_MESSAGE_MAX = 64
LOOKS_PER_TURN_MAX = 64
"""This number of looks for a member's nearest item takes one or two milliseconds. Then the stream lets other tasks
run.
"""


class MatchStream:
    """Serves one stream."""

    def __init__(self, groups: GroupStore, dial: Dial, context: Context, stream: OpenStream) -> None:
        self._groups = groups
        self._dial = dial
        self._stream = stream
        self._context = context
        self._writer = EventWriter(context, "match")
        self._waiter = Waiter()
        self._credit = Credit(self._waiter.wake)
        self._near: dict[bytes, HostedChannel] = {}  # members at this host, the matched channel among them
        # members at other hosts, each with the task that follows it
        self._remote: dict[bytes, tuple[RemoteMember, asyncio.Task[None]]] = {}

    async def run(self) -> None:
        """Serve until the stream ends, or until the reader has closed its side and its credit is spent.

        Raises InvalidArgument, GROUP_NOT_FOUND, IncarnationLost if the group began anew, StaleBinding if the matched
        channel has left the host, Unavailable if the group has no cut, Overloaded if the reader is too slow.
        """
        opening = await self._context.read()
        if not isinstance(opening, pb.SubscribeMatchesRequest) or not opening.HasField("open"):
            raise InvalidArgument("the first request of a subscription to matches has no open; send it before credit")
        request = opening.open
        self._credit.grant(opening.credit_bytes)
        if not request.HasField("tolerance_nanos") or request.tolerance_nanos < 0:
            raise InvalidArgument("tolerance_nanos is required and 0 or more: the greatest distance of matched times")
        if request.lateness_nanos < 0:
            raise InvalidArgument(f"lateness_nanos is {request.lateness_nanos}; it is a time to wait: give 0 or more")
        group = await self._groups.find(request.group_id)
        await self._writer.turn()  # many streams may have waited for the same group
        check_access(AccessVerb.READ, AccessKind.GROUP, group.record.name)
        # checked before the wait below, and found again after it
        matched = self._groups.channels.find(request.per_channel_id, request.epoch)
        check_access(AccessVerb.READ, AccessKind.CHANNEL, matched.record.name)
        if not await group.reach(None, SETTLE_SECONDS_MAX):
            raise Unavailable(f"group {group.record.name} shows nothing {group.held_by()}; subscribe again")
        await self._writer.turn()
        if request.after.group_incarnation not in (0, group.record.incarnation):
            raise other_incarnation(group.record)
        hosted = self._groups.channels.find(request.per_channel_id, request.epoch)
        self._groups.observe(group, self._waiter, of_members=True)
        hosted.match_streams.add(self._waiter)
        reading = self._stream.spawn(self._read())
        try:
            with self._groups.channels.readers.reading(hosted.record.name) as drops:
                await self._serve(group, hosted, request, drops)
        finally:
            reading.cancel()
            self._groups.stop_observing(group, self._waiter)
            hosted.match_streams.discard(self._waiter)
            for near in self._near.values():
                near.group_readers.pop(self, None)
            for _, following in self._remote.values():
                following.cancel()

    async def _read(self) -> None:
        """Read requests that grant credit."""
        async for request in requests_of(self._context.read):
            if request.HasField("open"):
                raise InvalidArgument("the stream is open already; leave `open` out after the first request")
            self._credit.grant(request.credit_bytes)
        self._credit.end()

    async def _serve(
        self, group: HostedGroup, hosted: HostedChannel, request: pb.SubscribeMatchesOpen, drops: ReaderDrops
    ) -> None:
        now = self._groups.channels.now()
        matcher = _matcher(hosted, request, now)
        generation, incarnation = 0, group.record.incarnation
        # the counts `unmatched` and `dropped` that the reader has got; None: it has got no response yet
        # from the first response without a match the reader knows that the stream follows every member
        counted: tuple[int, int] | None = None
        while counted is None or not self._credit.is_over:
            await self._writer.turn()
            if generation != group.generation:
                generation = group.generation
                group.check_incarnation(incarnation)
                member = member_of(group, hosted)
                matcher.set_tracks(self._tracks_of(group, member, matcher.earliest, unique=request.unique))
            found = await self._take(matcher, group, request)
            if matcher.has_more and not found:
                await asyncio.sleep(0)  # there is much to look at: let other tasks run first
                continue
            holds = counted is not None or all(remote.is_followed for remote, _ in self._remote.values())
            has_changed = bool(found) or (holds and counted != (matcher.unmatched, matcher.dropped))
            wanted = counted is None or self._credit.amount_left > 0  # without credit the stream sends nothing
            if not (has_changed and (found or wanted)) and (self._writer.silence_left_s > 0 or not wanted):
                await self._waiter.wait(self._writer.silence_left_s if wanted else None)
                continue
            counted = (matcher.unmatched, matcher.dropped)
            drops.count(matcher.dropped, 0)
            about = pb.SubscribeMatchesResponse(
                unmatched=matcher.unmatched,
                dropped=matcher.dropped,
                cursor=_cursor(matcher, group),
            )
            await self._send(about, found, group, hosted, without_payloads=request.without_payloads)

    def _tracks_of(self, group: HostedGroup, hosted: HostedChannel, since: int, *, unique: bool) -> dict[bytes, Track]:
        """Follow the present members of the group. Returns the tracks of all members but the matched channel.

        A member at this host is read in memory. A subscription (`RemoteMember`) follows a member at another host.
        """
        members, matched = group.cut.definition.members, hosted.record.channel_id
        owned = {channel_id: self._groups.own(channel_id) for channel_id in members}
        near = {channel_id: own.hosted for channel_id, own in owned.items() if own is not None} | {matched: hosted}
        for former in self._near.values():
            former.group_readers.pop(self, None)
        for present in near.values():
            present.group_readers[self] = None
        self._near = near
        for channel_id in [one for one in self._remote if one in near or one not in members]:
            self._remote.pop(channel_id)[1].cancel()
        tracks = {one: _track_of(own, unique=unique) for one, own in near.items() if one != matched}
        return tracks | {one: self._follow(group, one, since).track for one in members - near.keys()}

    def _follow(self, group: HostedGroup, channel_id: bytes, since: int) -> RemoteMember:
        if channel_id in self._remote:
            remote, _ = self._remote[channel_id]
        else:
            remote = RemoteMember(channel_id, since)
            self._remote[channel_id] = remote, self._stream.spawn(remote.keep(self._dial, self._waiter.wake))
        record = group.channels.get(channel_id)
        if record is not None:
            remote.epoch, remote.target = record.epoch, group.targets.get(record.host_id, remote.target)
        return remote

    async def _take(self, matcher: Matcher, group: HostedGroup, request: pb.SubscribeMatchesOpen) -> list[FoundMatch]:
        """Take the next decided matches: about one message, and about as many bytes as the credit allows.

        Raises Unavailable if an archive cannot be read.
        """
        taken: list[FoundMatch] = []
        credit = min(self._credit.amount_left, MESSAGE_BYTES_MAX)
        while True:
            most = MATCHES_PER_MESSAGE_MAX - len(taken) if credit > 0 else 0
            try:
                found = self._decided(matcher, group, request, most, credit)
            except ItemsNotLoaded as missing:
                if taken:
                    return taken
                await load(self._groups.channels, self._near[missing.channel_id], missing)
                await self._writer.turn()
                continue
            is_archived = bool(found) and bool(found[-1].archived)
            if is_archived:
                found[-1] = await filled(self._groups.channels, self._near, found[-1])
                await self._writer.turn()
            taken += found
            charge = sum(one.charge_bytes for one in found)
            self._credit.spend(charge)
            credit -= charge
            if not is_archived or credit <= 0 or len(taken) >= MATCHES_PER_MESSAGE_MAX:
                return taken

    def _decided(
        self, matcher: Matcher, group: HostedGroup, request: pb.SubscribeMatchesOpen, most: int, credit: int
    ) -> list[FoundMatch]:
        """The next decided matches, at most `most`. Raises ItemsNotLoaded."""
        now = self._groups.channels.now()

        def has_passed(channel_id: bytes, instant: int) -> bool:
            asked_channel_id = request.per_channel_id if channel_id == OWN else channel_id
            return self._has_passed(group, asked_channel_id, instant, request.lateness_nanos, now)

        return matcher.take(has_passed, now, most, credit, LOOKS_PER_TURN_MAX)

    def _has_passed(self, group: HostedGroup, channel_id: bytes, instant: int, lateness_nanos: int, now: int) -> bool:
        """Whether a member has passed `instant`. An idle member counts as having passed it."""
        member = group.cut.member(channel_id, now)
        if channel_id in self._remote:
            return self._remote[channel_id][0].has_passed(instant, lateness_nanos, is_idle=member.is_idle)
        if member.is_idle:
            return True
        return member.known is not None and member.known.times.has_passed(instant, lateness_nanos)

    async def _send(
        self,
        about: pb.SubscribeMatchesResponse,
        found: list[FoundMatch],
        group: HostedGroup,
        hosted: HostedChannel,
        *,
        without_payloads: bool,
    ) -> None:
        incarnations = {channel_id: record.incarnation for channel_id, record in group.channels.items()}
        incarnations |= {
            channel_id: remote.incarnation for channel_id, (remote, _) in self._remote.items() if remote.incarnation
        }
        await self._writer.write(matches(about, found, incarnations, without_payloads=without_payloads))
        for one in found if not without_payloads else ():
            hosted.count_delivered(1, one.item.slice.payload_bytes)
            for channel_id, partner in one.matched.items():
                if partner.item is not None:
                    self._near[channel_id].count_delivered(1, partner.item.slice.payload_bytes)


def _matcher(hosted: HostedChannel, request: pb.SubscribeMatchesOpen, now: int) -> Matcher:
    after = request.after
    partners = {one.channel_id: (one.position.time_unix_nano, one.position.seq) for one in after.partners}
    recording, channel_id = hosted.recording, hosted.record.channel_id
    if recording is not None and request.HasField("after") and not after.next_seq:
        recording.check_start(Bound(None, after.after.time_unix_nano), now)
    return Matcher(
        hosted.channel,
        {},
        request.tolerance_nanos,
        now,
        after=position_of(after.after) if request.HasField("after") else None,
        next_seq=after.next_seq or None,
        partners=partners if request.unique else None,
        recorded=None
        if recording is None
        else RecordedOwnTrack(hosted.channel, channel_id, lambda: recording.kept_from),
    )


def _track_of(hosted: HostedChannel, *, unique: bool) -> Track:
    """The track of a member at this host. Only `unique` searches again at earlier times."""
    if hosted.recording is None:
        return LocalTrack(hosted.channel)
    return RecordedTrack(hosted.channel, hosted.record.channel_id, is_ascending=not unique)


def _cursor(matcher: Matcher, group: HostedGroup) -> pb.MatchCursor:
    cursor = pb.MatchCursor(
        after=position_to(matcher.position),
        next_seq=matcher.next_seq,
        group_incarnation=group.record.incarnation,
    )
    for channel_id, (time, seq) in matcher.partners.items():
        position = item_pb2.ItemPosition(time_unix_nano=time, seq=seq)
        cursor.partners.add(channel_id=channel_id, position=position)
    return cursor
