"""Matches under a virtual clock: the rule of `Group.match`, over the recorded changes of all members."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt._async.archived_matches import ArchivedMatches
from stampede_rt._async.archived_matching import ArchivedMatching, ArchivedMember
from stampede_rt._async.change_feed import ChangeFeed
from stampede_rt._async.replayed_channel import ReplayedChannel
from stampede_rt._async.virtual_clock import VirtualClock
from stampede_rt.transports.concurrency_async import begin_if_blocking
from stampede_rt.values.grouping import GroupInfo
from stampede_rt.values.match_rule import MatchRule


class ReplayedMatches(ArchivedMatches[ReplayedChannel]):
    """The matches of a replayed group. Each step moves the clock to the instant at which a host could have decided the
    match. The iteration ends with the replay.
    """

    def __init__(
        self,
        clock: VirtualClock,
        group: GroupInfo,
        channels: Sequence[ReplayedChannel],
        per: ReplayedChannel,
        rule: MatchRule,
    ) -> None:
        super().__init__()
        self._clock, self._group, self._channels, self._per, self._rule = clock, group, channels, per, rule
        self._feeds: list[tuple[ArchivedMember, ChangeFeed]] = []
        self._is_loaded = False
        begin_if_blocking(self._open)

    def __repr__(self) -> str:
        return f"<ReplayedMatches of group {self._group.name!r}>"

    async def _begin(self) -> ArchivedMatching:
        members = [ArchivedMember(one, one.read_as_of) for one in self._channels]
        per = next(one for one in members if one.id == self._per.info.channel_id)
        matching = ArchivedMatching(self._group, members, per, self._rule)
        await matching.begin(self._clock.now)
        feeds = (
            ChangeFeed(one, member.past, payloads=False) for one, member in zip(self._channels, members, strict=True)
        )
        self._feeds = list(zip(members, feeds, strict=True))
        return matching

    async def _take_next_change(self, matching: ArchivedMatching) -> bool:
        """Take the earliest of the next changes of all members. Returns False at the end of the replay."""
        if not self._is_loaded:
            await matching.load_all()
            self._is_loaded = True
        due = [(feed.next_change, at) for at, (_, feed) in enumerate(self._feeds) if feed.next_change is not None]
        if not due:
            return False
        instant, at = min(due)
        assert instant is not None, "only members with a change are due"
        matching.check_room()
        member, feed = self._feeds[at]
        items = await feed.take()
        matching.as_of, member.advance = instant, feed.advance
        times = [one.time for one in items] + ([] if member.newest_time is None else [member.newest_time])
        member.newest_time = max(times, default=None)
        matching.add(member.id, [(one.time, one.seq) for one in items])
        return True

    async def _reach(self) -> None:
        if self._matching is not None:
            await self._clock.reach(self._matching.as_of)
