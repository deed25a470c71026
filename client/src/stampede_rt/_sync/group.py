# Generated from ../_async by tools/generate.py; do not edit.
"""A channel group's handle: descriptors of its channels, and reads of all of them at one cut (paper, section 3.3)."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar, overload

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.cuts import CutSubscription
from stampede_rt._sync.group_channel import GroupChannel
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt._sync.group_reads import MemberAnswers, read_members
from stampede_rt._sync.matches import MatchSubscription
from stampede_rt._sync.past_matches import PastMatches
from stampede_rt._sync.reader import Reader
from stampede_rt._sync.session import CALL_TIMEOUT_S, request_id
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.tracing import span
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
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.v1 import group_service_pb2 as group_pb
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import (
    ByChannel,
    GroupInfo,
    GroupStatus,
    NamedChannel,
    NewestItems,
    parse_lateness,
    parse_max_wait,
    parse_members,
)
from stampede_rt.values.match_rule import MatchRule
from stampede_rt.values.reading import ReadQuery, parse_as_of, parse_limit
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    BoundLike,
    Bounds,
    DurationLike,
    InstantLike,
    Match,
    MatchLike,
    parse_interval,
    parse_match,
)
from stampede_rt.wire.groups import member_status

Result = TypeVar("Result")

HOST_TIMEOUT_S = 2.0  # for one host; after this time the client asks another host


class Group(Reference):
    """A set of channels that readers see up to one common cut (paper, section 3.3).

    Handles of one group are equal. Any process may have any number of them. A group is a sequence of descriptors:
    `group[channel]` shows the items of that channel before the cut, and a loop over the group visits every member.
    """

    def __init__(self, members: GroupMembers) -> None:
        self._session = members.session
        self._members = members

    @property
    def info(self) -> GroupInfo:
        """The directory's description of the group, as last known."""
        return self._members.info

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Handles of the members, in the order in which they joined."""
        return self._members.channels

    @property
    def name(self) -> str:
        """The group's name."""
        return self.info.name

    @property
    def incarnation(self) -> int:
        """The group's incarnation, as last known. If it changes, the cut may be lower than before."""
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
        """Return the descriptor of a member. `channel` is the member's name, or a handle or descriptor of it.

        The descriptor has the codec of that handle. Raises InvalidArgument for a channel that is not a member.
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
        as_of: InstantLike | None = None,
    ) -> ByChannel[Channel, Items]:
        """Return for each member the items in an interval.

        The client reads all members at one cut, even if several hosts own them. The arguments are as in `Channel.get`.
        A meta-time means each channel's own instant: NEWEST is the time of the channel's own newest item. The
        answer maps each member to its Items.

        With `as_of` the answer uses the cut of that instant. All members must be recorded, and the caller must have the
        right to read all members that decide the cut. If the archives no longer have the facts for that cut, the reason
        of each answer is COLLECTED or LOST. Raises GroupNotFound, InvalidInterval, InvalidArgument, PermissionDenied,
        Unavailable.
        """
        query = ReadQuery(
            parse_interval(start, end, bounds),
            match=parse_match(match),
            limit=parse_limit(limit),
            newest_first=newest_first,
            payloads=payloads,
            as_of=parse_as_of(as_of),
        )
        return (self._read(query)).answers

    def newest(self, *, payloads: bool = True, as_of: InstantLike | None = None) -> NewestItems[Channel]:
        """Return the newest visible item of each member, all at one cut. A member without visible items has None.

        `.reasons[channel]` of the answer says why a member has no visible item. By default the cut is the time of the
        newest item of the member that is furthest behind, and the group shows only items before the cut. If each member
        has only one item, the group may therefore show nothing for a member. `as_of`: see `get`. Raises as `get`.
        """
        interval, past = parse_interval(MIN_INSTANT, MAX_INSTANT), parse_as_of(as_of)
        answers, reason = self._read(
            ReadQuery(interval, match=Match.START, limit=1, newest_first=True, payloads=payloads, as_of=past)
        )
        found = {channel.info.channel_id: items for channel, items in answers.items()}
        return NewestItems(self.channels, found, reason)

    def _read(self, query: ReadQuery) -> MemberAnswers:
        with span("get", group=self.name):
            return self._with_members_of_now(functools.partial(read_members, self._members, query))

    def _with_members_of_now(self, operation: Callable[[], Result]) -> Result:
        """Return the result of `operation`.

        If it fails because the members have changed, ask for the present members and try once more.
        """
        known = self.info.group_id, self.info.spec_version
        try:
            return operation()
        except (InvalidArgument, ChannelNotFound, GroupNotFound):
            self._members.refresh()
            if (self.info.group_id, self.info.spec_version) == known:
                raise
        return operation()

    def subscribe(
        self,
        max_wait: DurationLike = "1s",
        *,
        lateness: DurationLike = "0s",
        payloads: bool = True,
        reconnect: DurationLike | None = None,
    ) -> CutSubscription:
        """Subscribe to cut events. Returns an iterator over `Cut` that is also a context manager.

        The host sends an event when the cut has advanced and every member has reached the cut, at the latest `max_wait`
        after the advance. A slow reader gets several events as one. With `lateness` the event waits until every member
        is beyond the cut by more than `lateness`, at most `max_wait` + `lateness`. Items that come out of order by at
        most `lateness` are therefore part of the event, and not late. After a broken connection the client tries to
        open the subscription again for the duration `reconnect` (None: without a limit). Raises InvalidArgument; the
        iterator raises GroupNotFound, IncarnationLost, Unavailable.
        """
        return CutSubscription(
            self._members, parse_max_wait(max_wait), parse_lateness(lateness), reconnect, payloads=payloads
        )

    @overload
    def match(
        self, per: NamedChannel | str, tolerance: DurationLike, *, unique: bool = ..., lateness: DurationLike = ...,
        partial: bool = ..., payloads: bool = ..., reconnect: DurationLike | None = ..., start: BoundLike | None = ...,
        as_of: None = None,
    ) -> MatchSubscription: ...  # fmt: skip
    @overload
    def match(
        self, per: NamedChannel | str, tolerance: DurationLike, *, unique: bool = ..., lateness: DurationLike = ...,
        partial: bool = ..., payloads: bool = ..., reconnect: DurationLike | None = ..., start: BoundLike | None = ...,
        as_of: InstantLike,
    ) -> PastMatches[Channel]: ...  # fmt: skip
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
        start: BoundLike | None = None,
        as_of: InstantLike | None = None,
    ) -> MatchSubscription | PastMatches[Channel]:
        """Match each new item of `per` with the nearest item of every other member. Returns an iterator over `Matched`.

        The nearest item must be at most `tolerance` before or after the item of `per`. The host sends a match as soon
        as every other member has passed the time of the item of `per` + `tolerance`. If a member has no item that near,
        the host sends no match and counts the item of `per` in `unmatched`. With `partial` the reader also gets such an
        item of `per`, and `missing` names the members without an item that near.

        With `unique` an item of another member is part of at most one match: the match of the nearest item of `per`.
        The host waits for items that come out of order by at most `lateness`. This delays every match by `lateness`.
        `reconnect` is as in `subscribe`. `start`: begin with the items of `per` from this bound on, in memory or in the
        archive; by default with the items that the host accepts from now on. Raises InvalidArgument; the iterator
        raises GroupNotFound, IncarnationLost, Unavailable, and Overloaded if one match needs too many archived items.

        With `as_of` the iterator returns the matches that the same subscription would have got immediately at that past
        instant, and ends (see `PastMatches`). This needs recorded members and a `start`.
        """
        rule = MatchRule.parse(tolerance, lateness, unique=unique, partial=partial, payloads=payloads, start=start)
        member, past = self._members.member(per), parse_as_of(as_of)
        if past is not None:
            return PastMatches(self._members, member, rule, past)
        return MatchSubscription(self._members, member, rule, reconnect)

    def status(self) -> GroupStatus[Channel]:
        """Return the cut, the members that hold the cut back, and each member's own cut, as one host sees them.

        Asks the members' hosts one after the other, each for at most 2 s, until one answers. Raises GroupNotFound,
        Unavailable.
        """
        return self._with_members_of_now(self._status)

    def _status(self) -> GroupStatus[Channel]:
        def status_at(binding: Binding, timeout_s: float) -> group_pb.GetGroupStatusResponse:
            endpoint = self._session.endpoints.to(binding.target)
            request = group_pb.GetGroupStatusRequest(group_id=self.info.group_id)
            response: group_pb.GetGroupStatusResponse = endpoint.call(
                endpoint.groups.GetGroupStatus, request, timeout_s
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

    def _at_any_host(self, operation: Callable[[Binding, float], Result]) -> Result:
        """Return the result of `operation` at the first of the members' hosts that answers."""
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
        """Make a channel a member. The cut stays, and the channel's items before the cut are visible immediately.

        Blocks for at most 10 s. Raises InvalidArgument, GroupNotFound, Unavailable.
        """
        (member,) = parse_members([channel])
        self._update(group_directory_pb.UpdateGroupRequest(add_channel_ids=[member.info.channel_id]), [member])

    def remove(self, channel: Channel) -> None:
        """Take a channel out of the group.

        Blocks for at most 10 s. Raises InvalidArgument for the reference and for the last member; GroupNotFound,
        Unavailable.
        """
        (member,) = parse_members([channel])
        self._update(group_directory_pb.UpdateGroupRequest(remove_channel_ids=[member.info.channel_id]), [])

    def _update(self, request: group_directory_pb.UpdateGroupRequest, known: Sequence[Channel]) -> None:
        request.request_id, request.group_id = request_id(), self.info.group_id
        self._session.supernodes.call("UpdateGroup", request, CALL_TIMEOUT_S)
        self._members.refresh(known)

    def refresh(self) -> None:
        """Ask the directory for the members, which other processes may have changed.

        Raises GroupNotFound, Unavailable.
        """
        self._members.refresh()

    def delete(self) -> None:
        """Delete the group for everyone. Its channels stay.

        The directory forgets the group immediately. The hosts learn of the deletion a moment later, and may answer
        reads until then. Blocks for at most 10 s. Raises GroupNotFound, Unavailable.
        """
        request = group_directory_pb.DeleteGroupRequest(request_id=request_id(), group_id=self.info.group_id)
        self._session.supernodes.call("DeleteGroup", request, CALL_TIMEOUT_S)
