"""A group under a virtual clock: each read answers at the cut of the clock's instant."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import NoReturn

from stampede_rt._async.channel import Channel
from stampede_rt._async.group import Group
from stampede_rt._async.group_channel import read_at_past_cut
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.past_matches import PastMatches
from stampede_rt._async.reader import Reader
from stampede_rt._async.replayed_channel import ReplayedChannel, as_known
from stampede_rt._async.replayed_matches import ReplayedMatches
from stampede_rt._async.replayed_subscription import ReplayedSteps
from stampede_rt._async.replayed_visible import ReplayedVisible
from stampede_rt._async.virtual_clock import VirtualClock
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import ByChannel, GroupInfo, NamedChannel, NewestItems, is_named_by
from stampede_rt.values.match_rule import MatchRule
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery, parse_as_of
from stampede_rt.values.replaying import not_replayed
from stampede_rt.values.timeline import Bound, BoundLike, Bounds, DurationLike, InstantLike, MatchLike


class ReplayedGroup:
    """A group under a virtual clock. It reads and matches as `Group` does, with its present members.

    It has no cut events, and changes nothing.
    """

    def __init__(self, group: Group, clock: VirtualClock, end: int) -> None:
        self._group, self._clock, self._end = group, clock, end

    def __getattr__(self, name: str) -> NoReturn:
        raise not_replayed("Group", name, self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ReplayedGroup) and other.info.group_id == self.info.group_id

    def __hash__(self) -> int:
        return hash(self.info.group_id)

    def __repr__(self) -> str:
        return f"<ReplayedGroup {self.name!r} of {', '.join(one.name for one in self.channels)}>"

    @property
    def info(self) -> GroupInfo:
        """The directory's description of the group, as last known."""
        return self._group.info

    @property
    def name(self) -> str:
        """The group's name."""
        return self._group.name

    @property
    def incarnation(self) -> int:
        """The group's incarnation, as last known."""
        return self._group.incarnation

    @property
    def channels(self) -> tuple[ReplayedChannel, ...]:
        """The members, in the order in which they joined."""
        return tuple(ReplayedChannel(one, self._clock, self._end) for one in self._group.channels)

    def __getitem__(self, channel: NamedChannel | str) -> ReplayedGroupChannel:
        """Return the descriptor of a member (see `Group`)."""
        member = self._group._members.member(channel)
        handle = Channel(member._session, channel._state) if isinstance(channel, Reader) else member
        return ReplayedGroupChannel(self._group, handle, self._clock, self._end)

    def __iter__(self) -> Iterator[ReplayedGroupChannel]:
        return (self[channel] for channel in self._group.channels)

    def __len__(self) -> int:
        return len(self._group)

    async def refresh(self) -> None:
        """Ask the directory for the members (see `Group.refresh`)."""
        await self._group.refresh()

    async def get(
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
    ) -> ByChannel[ReplayedChannel, Items]:
        """Return for each member the items in an interval, at the cut of the clock's instant (see `Group.get`)."""
        read = functools.partial(
            self._group.get, start, end, bounds=bounds, match=match, limit=limit, newest_first=newest_first,
            payloads=payloads,
        )  # fmt: skip
        self._clock.check_open()
        if as_of is not None:
            found = await read(as_of=as_of)
        else:
            found = await as_known(lambda instant: read(as_of=instant), self._clock.now)
        return found.with_handles(self.channels)

    async def newest(self, *, payloads: bool = True, as_of: InstantLike | None = None) -> NewestItems[ReplayedChannel]:
        """Return the newest visible item of each member, at the cut of the clock's instant (see `Group.newest`)."""
        self._clock.check_open()
        if as_of is not None:
            found = await self._group.newest(payloads=payloads, as_of=as_of)
        else:
            found = await as_known(
                lambda instant: self._group.newest(payloads=payloads, as_of=instant), self._clock.now
            )
        return found.with_handles(self.channels)

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
    ) -> ReplayedMatches | ReplayedPastMatches:
        """Match each new item of `per` (see `Group.match`), from the clock's instant on. Raises InvalidArgument."""
        rule = MatchRule.parse(tolerance, lateness, unique=unique, partial=partial, payloads=payloads, start=start)
        member, past = self._group._members.member(per), parse_as_of(as_of)
        if past is not None:
            return ReplayedPastMatches(self._group._members, member, rule, past, self._clock, self._end)
        channels = self.channels
        matched = next(one for one in channels if is_named_by(member, one))
        return ReplayedMatches(self._clock, self.info, channels, matched, rule)


class ReplayedPastMatches(PastMatches[ReplayedChannel]):
    """The matches of a replayed group as of an explicit instant."""

    def __init__(
        self, group: GroupMembers, per: Channel, rule: MatchRule, as_of: int, clock: VirtualClock, end: int
    ) -> None:
        self._clock, self._end = clock, end
        super().__init__(group, per, rule, as_of)

    def _shown(self, channel: Channel) -> ReplayedChannel:
        return ReplayedChannel(channel, self._clock, self._end)

    async def _reach(self) -> None:
        self._clock.check_open()


class ReplayedGroupChannel(ReplayedChannel):
    """A descriptor under a virtual clock: a channel as a group showed it. Its NOW is the cut at the replay's time."""

    def __init__(self, group: Group, channel: Channel, clock: VirtualClock, end: int) -> None:
        super().__init__(channel, clock, end, group._members.view)
        self._group, self._channel = group, channel

    async def read_as_of(self, query: ReadQuery, as_of: int) -> Items:
        """Return the answer at the cut of an instant, or of the host's clock if that is earlier."""
        self._clock.check_open()
        read = functools.partial(read_at_past_cut, self._group._members, self._state, query)
        items, past = await as_known(read, as_of)
        changes = [one for one in (past.next_change, items.past and items.past.next_change) if one is not None]
        if items.past is not None:  # a change of any member may change the answer
            items.past = items.past._replace(next_change=min(changes, default=None), next_items=None)
        return items

    def _subscribe_all(self, start: Bound | None, after: Item | None, *, payloads: bool) -> ReplayedSteps:
        channel = ReplayedChannel(self._channel, self._clock, self.end)
        return ReplayedVisible(self, channel, self._group._members, self._clock, start, after, payloads=payloads)
