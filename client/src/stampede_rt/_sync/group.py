# Generated from ../_async by tools/generate.py; do not edit.
"""A channel group's handle: descriptors of its channels, and reads of all of them at one cut (paper, section 3.3)."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.cuts import CutSubscription
from stampede_rt._sync.group_channel import GroupChannel
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt._sync.matches import MatchSubscription
from stampede_rt._sync.reader import Reader
from stampede_rt._sync.reads import read
from stampede_rt._sync.session import CALL_TIMEOUT_S, request_id
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import (
    ChannelNotFound,
    DeadlineExceeded,
    GroupNotFound,
    InvalidArgument,
    StaleBinding,
    StampedeError,
    Unavailable,
)
from stampede_rt.handles import Reference, handle_repr
from stampede_rt.transports.concurrency_sync import run_all
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.v1 import group_service_pb2 as group_pb
from stampede_rt.values.grouping import (
    ByChannel,
    GroupInfo,
    GroupStatus,
    NamedChannel,
    NewestItems,
    parse_lateness,
    parse_max_wait,
    parse_members,
    parse_tolerance,
)
from stampede_rt.values.model import Items
from stampede_rt.values.reading import ReadQuery, parse_limit
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    BoundLike,
    Bounds,
    DurationLike,
    Match,
    MatchLike,
    parse_interval,
    parse_match,
)
from stampede_rt.wire.groups import member_status

Result = TypeVar("Result")

HOST_TIMEOUT_S = 2.0  # where any of several hosts may answer
CUT_WAIT_NANOS = 1_000_000_000  # how long a host that is behind the cut already seen may wait to catch up


class Group(Reference):
    """A set of channels that are read in step. Handles of one group are equal; any process may hold some."""

    def __init__(self, members: GroupMembers) -> None:
        self._session = members.session
        self._members = members

    @property
    def info(self) -> GroupInfo:
        """The directory's description of the group, as last known."""
        return self._members.info

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The members, in the order in which they were named."""
        return self._members.channels

    @property
    def name(self) -> str:
        """The group's name."""
        return self.info.name

    @property
    def incarnation(self) -> int:
        """Which life of the group this is, as last known; in another one the cut may have begun anew."""
        return self.info.incarnation

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Group) and other.info.group_id == self.info.group_id

    def __hash__(self) -> int:
        return hash(self.info.group_id)

    def __repr__(self) -> str:
        members = ", ".join(channel.name for channel in self.channels)
        state = f", {self._session.state}" if self._session.state else ""
        return f"{handle_repr('Group', self.name, self.info.group_id, '', '')[:-1]} of {members}{state}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return self._session.reopened("group", self._members)

    def __getitem__(self, channel: NamedChannel | str) -> GroupChannel:
        """The descriptor of a member, by its handle, whose codec it has, or by its name.

        Raises InvalidArgument for a channel that is no member.
        """
        member = self._members.member(channel)
        return GroupChannel(self._members, channel._state if isinstance(channel, Reader) else member._state)

    def __iter__(self) -> Iterator[GroupChannel]:
        return (self[channel] for channel in self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    def get(
        self,
        start: BoundLike,
        end: BoundLike,
        *,
        bounds: Bounds = "[]",
        match: MatchLike = "span",
        limit: int | None = None,
        newest_first: bool = False,
        payloads: bool = True,
    ) -> ByChannel[Channel, Items]:
        """What each channel shows in an interval, all at one cut, on all hosts; see `Channel.get`.

        A meta-time is each channel's own. Raises GroupNotFound, InvalidInterval, Unavailable.
        """
        interval = parse_interval(start, end, bounds)
        return self._read(
            ReadQuery(
                interval,
                match=parse_match(match),
                limit=parse_limit(limit),
                newest_first=newest_first,
                payloads=payloads,
            )
        )

    def newest(self, *, payloads: bool = True) -> NewestItems[Channel]:
        """The newest visible item of each channel, all at one cut; None where nothing is visible.

        `.reasons[channel]` of the answer says why: the cut lies at the earliest of the members' newest items, and shows
        what is before it, so right after the first ones nothing is visible.
        """
        interval = parse_interval(MIN_INSTANT, MAX_INSTANT)
        answers = self._read(ReadQuery(interval, match=Match.START, limit=1, newest_first=True, payloads=payloads))
        return NewestItems(self.channels, {channel.info.channel_id: items for channel, items in answers.items()})

    def _read(self, query: ReadQuery) -> ByChannel[Channel, Items]:
        return self._with_members_of_now(functools.partial(self._read_all, query))

    def _with_members_of_now(self, operation: Callable[[], Result]) -> Result:
        """The result of `operation`; once more, if it fails because others have let members in or out."""
        known = self.info.group_id, self.info.spec_version
        try:
            return operation()
        except (InvalidArgument, ChannelNotFound, GroupNotFound):
            self._members.refresh()
            if (self.info.group_id, self.info.spec_version) == known:
                raise
        return operation()

    def _read_all(self, query: ReadQuery) -> ByChannel[Channel, Items]:
        query = replace(query, cut=self._cut())
        answers = run_all(
            [functools.partial(read, self._session, one._state, query, self._members.view) for one in self.channels]
        )
        ids = (channel.info.channel_id for channel in self.channels)
        return ByChannel(self.channels, dict(zip(ids, answers, strict=True)))

    def _cut(self) -> int:
        """One cut for one read of all channels; the least instant: nothing is visible yet."""

        def cut_at(binding: Binding) -> group_pb.GetCutResponse:
            endpoint = self._session.endpoints.to(binding.target)
            request = group_pb.GetCutRequest(
                group_id=self.info.group_id, cut_floor_unix_nano=self._members.view.cut_floor, wait_nanos=CUT_WAIT_NANOS
            )
            response: group_pb.GetCutResponse = endpoint.call(endpoint.groups.GetCut, request, CALL_TIMEOUT_S)
            return response

        response = self._session.perform(self.channels[0]._state, cut_at)
        if not response.HasField("floor"):
            return MIN_INSTANT
        if (response.floor.spec_version, response.floor.incarnation) != (self.info.spec_version, self.incarnation):
            self._members.refresh()
        self._members.view.saw(response.floor.cut_unix_nano)
        return int(response.floor.cut_unix_nano)

    def subscribe(
        self,
        max_wait: DurationLike = "1s",
        *,
        lateness: DurationLike = "0s",
        payloads: bool = True,
        reconnect: DurationLike | None = None,
    ) -> CutSubscription:
        """Events that say what became visible, in step over all channels: an iterator and context manager.

        An event comes when the cut has advanced and every member has caught up with it, or `max_wait` later. A slow
        reader gets merged events. Items that come out of order by up to `lateness` are waited for, so that they come
        with the others and not as late ones; it delays every event by as much.
        """
        return CutSubscription(
            self._members, parse_max_wait(max_wait), parse_lateness(lateness), reconnect, payloads=payloads
        )

    def match(
        self,
        per: NamedChannel | str,
        tolerance: DurationLike,
        *,
        unique: bool = False,
        lateness: DurationLike = "0s",
        partial: bool = False,
        payloads: bool = True,
        reconnect: DurationLike | None = None,
    ) -> MatchSubscription:
        """For each new item of `per`, the nearest item of every other member within `tolerance`: an iterator.

        A match comes as soon as every other member has passed its time + tolerance. Items without a partner are
        counted (`unmatched`); with `partial` they come, too, and `missing` names who has none for them.

        With `unique` each item of another member comes in one match at the most: the nearest pair is made first. Items
        that come out of order by up to `lateness` are waited for, which delays every match by as much.
        """
        return MatchSubscription(
            self._members,
            self._members.member(per),
            parse_tolerance(tolerance),
            reconnect,
            lateness_nanos=parse_lateness(lateness),
            unique=unique,
            partial=partial,
            payloads=payloads,
        )

    def status(self) -> GroupStatus[Channel]:
        """The cut, who holds it back, and how far each member is, as the first of the members' hosts that answers
        sees it."""
        return self._with_members_of_now(self._status)

    def _status(self) -> GroupStatus[Channel]:
        def status_at(binding: Binding) -> group_pb.GetGroupStatusResponse:
            endpoint = self._session.endpoints.to(binding.target)
            request = group_pb.GetGroupStatusRequest(group_id=self.info.group_id)
            response: group_pb.GetGroupStatusResponse = endpoint.call(
                endpoint.groups.GetGroupStatus, request, HOST_TIMEOUT_S
            )
            return response

        status = (self._at_any_host(status_at)).status
        if status.record.spec_version != self.info.spec_version:
            self._members.refresh()
        by_id = {channel.info.channel_id: channel for channel in self.channels}
        return GroupStatus(
            cut=status.cut_unix_nano if status.HasField("cut_unix_nano") else None,
            waiting_on=tuple(by_id[one] for one in status.waiting_on_channel_ids if one in by_id),
            members=ByChannel(self.channels, {one.times.channel_id: member_status(one) for one in status.members}),
            host_time=status.host_time_unix_nano,
        )

    def _at_any_host(self, operation: Callable[[Binding], Result]) -> Result:
        """The result of `operation` at the first of the members' hosts that can be reached."""
        failure: StampedeError = Unavailable(f"the group {self.name!r} has no members")
        first_at: dict[str, Channel] = {}
        for channel in self.channels:
            first_at.setdefault(channel.host, channel)
        for member in first_at.values():
            try:
                return self._session.perform(member._state, operation, HOST_TIMEOUT_S)
            except (Unavailable, DeadlineExceeded, StaleBinding) as error:
                failure = error
        raise failure

    def add(self, channel: Channel) -> None:
        """Make a channel a member. The cut stays; what the channel holds below it is readable at once."""
        (member,) = parse_members([channel])
        self._update(group_directory_pb.UpdateGroupRequest(add_channel_ids=[member.info.channel_id]), [member])

    def remove(self, channel: Channel) -> None:
        """Make a channel leave the group. Raises InvalidArgument for the reference and the last member."""
        (member,) = parse_members([channel])
        self._update(group_directory_pb.UpdateGroupRequest(remove_channel_ids=[member.info.channel_id]), [])

    def _update(self, request: group_directory_pb.UpdateGroupRequest, known: Sequence[Channel]) -> None:
        request.request_id, request.group_id = request_id(), self.info.group_id
        self._session.supernodes.call("UpdateGroup", request, CALL_TIMEOUT_S)
        self._members.refresh(known)

    def refresh(self) -> None:
        """Learn the members anew, which other processes may have changed. Raises GroupNotFound."""
        self._members.refresh()

    def delete(self) -> None:
        """Forget the group, for everyone; its channels stay.

        The directory forgets it at once. Its hosts hear of that a moment later, and may still answer reads until then.
        """
        request = group_directory_pb.DeleteGroupRequest(request_id=request_id(), group_id=self.info.group_id)
        self._session.supernodes.call("DeleteGroup", request, CALL_TIMEOUT_S)
