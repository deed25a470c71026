"""The matches of a group as of an earlier instant."""

from __future__ import annotations

import functools

from stampede_rt._async.archived_matches import ArchivedMatches, Key
from stampede_rt._async.archived_matching import ArchivedMatching, ArchivedMember
from stampede_rt._async.channel import Channel
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.present_cuts import confirm_members
from stampede_rt._async.reader import Reader
from stampede_rt._async.reads import read_as_of
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import ChannelNotFound, GroupNotFound, InvalidArgument
from stampede_rt.transports.concurrency_async import begin_if_blocking
from stampede_rt.values.match_rule import MatchRule


class PastMatches(ArchivedMatches[Key]):
    """The matches that a subscription would have got immediately at an instant (see `Group.match` with `as_of`).

    A step raises PermissionDenied if the caller may not read a member, and Unavailable.
    """

    def __init__(self, group: GroupMembers, per: Channel, rule: MatchRule, as_of: int) -> None:
        super().__init__()
        if rule.start is None:
            raise InvalidArgument(
                "as_of: without a start there are only matches of new items, and a past instant has no new items; "
                "give start, such as start=OLDEST"
            )
        self._group, self._per, self._rule, self._as_of = group, per, rule, as_of
        begin_if_blocking(self._open)

    def __repr__(self) -> str:
        return f"<PastMatches of group {self._group.name!r} as of {self._as_of}>"

    async def _begin(self) -> ArchivedMatching:
        with span("match", group=self._group.name):
            try:
                await confirm_members(self._group, self._per)
            except (ChannelNotFound, GroupNotFound):
                await self._group.refresh()
            group, per = self._group, self._group.member(self._per)
            members = [self._member(one) for one in group.channels]
            matched = next(one for one in members if one.id == per.info.channel_id)
            matching = ArchivedMatching(group.info, members, matched, self._rule)
            await matching.begin(self._as_of)
        return matching

    def _member(self, channel: Channel) -> ArchivedMember:
        return ArchivedMember(self._shown(channel), functools.partial(read_as_of, self._group.session, channel._state))

    def _shown(self, channel: Channel) -> Reader:
        """Return the handle that the matches have as a key."""
        return channel
