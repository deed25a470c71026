"""Gets and subscriptions of channels that name a group (paper, section 3.3).

Each host computes the cut itself, so a read costs no further round trip. The host waits for the other hosts only if a
reader has seen a later cut, or if they have not reported their cuts of a new group yet.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from stampede_rt.errors import InvalidArgument, Overloaded, Unavailable
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.timeline import Interval, ResolvedInterval
from stampede_rt_channel_host.channels import copied_archives, refusals
from stampede_rt_channel_host.channels.copy_state import Freshness
from stampede_rt_channel_host.channels.gets.waiting_gets import WAITING_GETS_MAX
from stampede_rt_channel_host.channels.group_access import Cursor, GroupAnswer, GroupReadParams
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.observers import ChangeObserver
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.channels.requests import beginning_of, is_newest
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import (
    PendingGet,
    Pieces,
    Query,
    ReadAnswer,
    SavedCursor,
    SubscriptionBatch,
    UnfinishedWork,
    WakeAt,
    first_of,
)
from stampede_rt_channel_host.core.group import VisibleAllCursor, VisibleChannel, VisibleNewestCursor
from stampede_rt_channel_host.groups.copied_groups import CopiedGroup, CopiedGroups
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.recorded_gets import (
    is_over,
    read_past_in_group,
    read_recorded_in_group,
    reads_archive,
)
from stampede_rt_channel_host.groups.recorded_subscriptions import RecordedSteps, resolved_start
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.groups.waiting_gets import GroupGets, PendingGroupGet
from stampede_rt_runtime.access.control import check_access
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb

STALL_SECONDS_MAX = 1.0  # a get may wait this long for the cut, even if its own limit is shorter
SETTLE_SECONDS_MAX = 5.0  # the longest wait for the cut at the beginning of a subscription


class GroupReads:
    """Implements `GroupAccess`."""

    def __init__(self, groups: GroupStore, copied: CopiedGroups) -> None:
        """`copied`: the groups of copies at this host."""
        self._groups = groups
        self._copied = copied

    def read_now(
        self,
        params: GroupReadParams,
        hosted: HostedChannel,
        query: Query,
        wait_nanos: int,
        now: int,
        check: Callable[[str], None],
    ) -> GroupAnswer | None:
        """See `GroupAccess`."""
        group = self._groups.known(params.group_id) if hosted.copy is None else None
        if group is not None:
            check(group.record.name)
        if group is None or not group.has_reached(_wanted(params)):
            return None
        view, horizon = VisibleChannel(member_of(group, hosted).channel), group.horizon(params.at)
        if reads_archive(params, hosted, query, horizon, now):
            return None
        found: ReadAnswer | WakeAt | UnfinishedWork[ReadAnswer] | UnfinishedWork[ReadAnswer | WakeAt]
        if wait_nanos:
            found = first_of(view.polling(view.begin(query, horizon, now), horizon, now))
        else:
            found = first_of(view.reading(query, horizon, now))
        return GroupAnswer(found, horizon.cut) if isinstance(found, ReadAnswer) else None

    async def read(
        self,
        params: GroupReadParams,
        hosted: HostedChannel,
        query: Query,
        wait_nanos: int,
        check: Callable[[str], None],
    ) -> GroupAnswer:
        """See `GroupAccess`."""
        if params.as_of is not None:
            return await self._read_past(params, hosted, query, check)
        if hosted.copy is not None:
            return await self._read_copy(params, hosted, query, wait_nanos, check)
        wait_s = None if wait_nanos < 0 else wait_nanos / 1e9
        deadline_s = None if wait_s is None else _now_s() + wait_s
        group = await self._groups.find(params.group_id)
        check(group.record.name)
        view = VisibleChannel(member_of(group, hosted).channel)
        wanted = _wanted(params)
        if not await group.reach(wanted, None if wait_s is None else max(STALL_SECONDS_MAX, wait_s)):
            horizon = group.horizon()
            stalled_at = 0 if wanted is None else wanted
            return GroupAnswer(view.stalled(stalled_at, horizon), horizon.cut)
        self._check_served(hosted)
        if reads_archive(params, hosted, query, group.horizon(params.at), self._groups.channels.now()):
            return await self._get_recorded(group, hosted, params.at, query, deadline_s)
        pending = VisibleChannel(hosted.channel).begin(query, group.horizon(params.at), self._groups.channels.now())
        return await self._get(group, hosted, PendingGroupGet(pending, params.at), deadline_s)

    async def _read_past(
        self, params: GroupReadParams, hosted: HostedChannel, query: Query, check: Callable[[str], None]
    ) -> GroupAnswer:
        """Read as of an earlier instant, at the cut of the request."""
        group = await self._groups.find(params.group_id)
        check(group.record.name)
        member_of(group, hosted)
        found = await read_past_in_group(self._groups.channels, params, hosted, query)
        self._check_served(hosted)
        return found

    async def _get_recorded(
        self, group: HostedGroup, hosted: HostedChannel, at: int | None, query: Query, deadline_s: float | None
    ) -> GroupAnswer:
        """Read the archive and memory. Without an answer, wait until a later cut or a later item brings one."""
        within: ResolvedInterval | None = None
        has_waited, incarnation = False, group.record.incarnation
        while True:  # an answer ends it
            is_last = has_waited or at is not None or (deadline_s is not None and deadline_s <= _now_s())
            found = await read_recorded_in_group(
                self._groups.channels, hosted, query, group.horizon(at), within, waits=not is_last
            )
            self._check_served(hosted)
            group.check_incarnation(incarnation)
            member_of(group, hosted)
            if is_last or is_over(found.view, query):
                return found.answer
            within = found.view.within
            if found.view.released_by is not None:
                await group.reach(found.view.released_by, _left_s(deadline_s))
            else:
                await self._get(group, hosted, PendingGroupGet(PendingGet(query, within), at), deadline_s)
                has_waited = True

    async def _read_copy(
        self,
        params: GroupReadParams,
        hosted: HostedChannel,
        query: Query,
        wait_nanos: int,
        check: Callable[[str], None],
    ) -> GroupAnswer:
        """Read a copy. Raises StaleBinding (MOVED) for a get that would have to wait for items, or that may need the
        archive.
        """
        group = await self._copied.find(params.group_id, hosted)
        check(group.record.name)
        await group.reach(_wanted(params), STALL_SECONDS_MAX)
        channels, horizon = self._groups.channels, group.horizon(params.at)
        view = VisibleChannel(member_of(group, hosted).channel)
        reads_archive(params, hosted, query, horizon, channels.now())  # a copy has none, and sends the reader away
        if not wait_nanos:
            return GroupAnswer(await channels.scheduler.do(view.reading(query, horizon, channels.now())), horizon.cut)
        pending = view.begin(query, horizon, channels.now())
        found = await channels.scheduler.do(view.polling(pending, horizon, channels.now()))
        if isinstance(found, WakeAt):
            raise refusals.copy_cannot(hosted.record.name, "has no answer yet, and reads of groups wait at the owner")
        return GroupAnswer(found, horizon.cut)

    async def _get(
        self, group: HostedGroup, hosted: HostedChannel, pending: PendingGroupGet, deadline_s: float | None
    ) -> GroupAnswer:
        """Look for the answer. Without an answer, wait until the get is released or `deadline_s` has come."""
        if len(hosted.group_gets) >= WAITING_GETS_MAX:
            raise Overloaded(f"{WAITING_GETS_MAX} gets wait at the channel already, the limit; subscribe, or get later")
        channels, view = self._groups.channels, VisibleChannel(hosted.channel)
        while True:  # an answer ends it
            horizon, stood = group.horizon(pending.at), _state(group, hosted)
            found = await channels.scheduler.do(view.polling(pending, horizon, channels.now()))
            if not isinstance(found, WakeAt):
                return GroupAnswer(found, horizon.cut)
            if _state(group, hosted) != stood:  # the state has changed between the pieces
                member_of(group, hosted)
                continue
            left_s = _left_s(deadline_s)
            waiting = GroupGets.of(
                group, hosted, channels.now, lambda: member_of(group, hosted), channels.scheduler, channels.limits
            )
            released, cut = await waiting.wait(pending, found, -1 if left_s is None else round(left_s * 1e9))
            if isinstance(released, ReadAnswer):
                return GroupAnswer(released, cut)
            rest: Pieces[ReadAnswer | WakeAt] = released.rest
            found = await channels.scheduler.finish(rest)
            if not isinstance(found, WakeAt):
                return GroupAnswer(found, cut)

    @asynccontextmanager
    async def subscribe(
        self, opening: pb.SubscribeOpen, hosted: HostedChannel, observer: ChangeObserver
    ) -> AsyncIterator[Cursor]:
        """See `GroupAccess`. Raises Unavailable if this host does not learn the cut in time."""
        group: HostedGroup | CopiedGroup
        if hosted.copy is None:
            group = await self._groups.find(opening.group_id)
        else:
            group = await self._copied.find(opening.group_id, hosted)
        check_access(AccessVerb.READ, AccessKind.GROUP, group.record.name)
        member_of(group, hosted)
        saved = opening.cursor  # a cursor of another incarnation needs no wait, because it is refused
        seen = saved.cut_unix_nano if saved.incarnation == hosted.channel.incarnation else None
        if not await group.reach(seen, SETTLE_SECONDS_MAX):
            raise Unavailable(f"group {group.record.name} shows nothing new {group.held_by()}; subscribe again")
        self._check_served(hosted)
        where = beginning_of(opening)
        if where.get("start") is not None and hosted.copy is None:
            where["start"] = await resolved_start(hosted, self._groups.channels, group.horizon, where["start"])
            self._check_served(hosted)
        cursor = _cursor(group, hosted, opening, where, self._groups.channels)
        group.cut_observers.add(observer)
        try:
            yield cursor
        finally:
            group.cut_observers.discard(observer)
            self._groups.channels.scheduler.begin(cursor.emptying())

    def _check_served(self, hosted: HostedChannel) -> None:
        """Check after a wait that this host still serves the channel. Raises StaleBinding or Unavailable if not."""
        found = self._groups.channels.find_readable(hosted.record.channel_id, hosted.epoch, Freshness())
        if found is not hosted:
            raise refusals.wrong_epoch(hosted.record.name, hosted.epoch, found.epoch)


class _AllModeCursor:
    """The cursor of a subscription through a group in SUBSCRIBE_MODE_ALL."""

    skipped = 0

    def __init__(
        self, group: HostedGroup | CopiedGroup, hosted: HostedChannel, cursor: VisibleAllCursor, steps: RecordedSteps
    ) -> None:
        self._group = group
        self._incarnation = group.record.incarnation
        self._hosted = hosted
        self._cursor = cursor
        self._steps = steps
        self.emptying = cursor.emptying

    @property
    def saved(self) -> SavedCursor | None:
        return None if self._steps.under_way else self._cursor.saved

    async def from_archive(
        self, recording: Recording, limit_bytes: int, now: Callable[[], int]
    ) -> SubscriptionBatch | None:
        self._group.check_incarnation(self._incarnation)
        member_of(self._group, self._hosted)
        return await self._steps.take(recording, self._group.horizon(), limit_bytes)

    def is_held(self, now: int) -> bool:
        return self._cursor.unheld_step(self._group.horizon(), now) is None

    def take(self, now: int, limit_bytes: int) -> SubscriptionBatch:
        self._group.check_incarnation(self._incarnation)
        member_of(self._group, self._hosted)
        return self._cursor.take(self._group.horizon(), now, limit_bytes)

    def progress(self, now: int) -> pb.SubscriptionProgress:
        return pb.SubscriptionProgress(next_seq=self._cursor.lowest_owed_seq(now), dropped=self._cursor.dropped)


class _NewestModeCursor:
    """The cursor of a subscription through a group in SUBSCRIBE_MODE_NEWEST."""

    def __init__(self, group: HostedGroup | CopiedGroup, hosted: HostedChannel, cursor: VisibleNewestCursor) -> None:
        self._group = group
        self._incarnation = group.record.incarnation
        self._hosted = hosted
        self._cursor = cursor
        self.emptying = cursor.emptying

    @property
    def saved(self) -> SavedCursor | None:
        return self._cursor.saved

    @property
    def skipped(self) -> int:
        return self._cursor.skipped

    async def from_archive(
        self, recording: Recording, limit_bytes: int, now: Callable[[], int]
    ) -> SubscriptionBatch | None:
        return None

    def is_held(self, now: int) -> bool:
        return True

    def take(self, now: int, limit_bytes: int) -> SubscriptionBatch:
        self._group.check_incarnation(self._incarnation)
        member_of(self._group, self._hosted)
        return self._cursor.take(self._group.horizon(), now)

    def progress(self, now: int) -> pb.SubscriptionProgress:
        return pb.SubscriptionProgress(next_seq=self._cursor.lowest_owed_seq(now), skipped=self._cursor.skipped)


def _cursor(
    group: HostedGroup | CopiedGroup, hosted: HostedChannel, opening: pb.SubscribeOpen, where: dict[str, Any],
    channels: ChannelStore,
) -> _AllModeCursor | _NewestModeCursor:  # fmt: skip
    horizon, now = group.horizon(), channels.now()
    if is_newest(opening):
        return _NewestModeCursor(group, hosted, VisibleNewestCursor(hosted.channel, horizon, now, **where))
    start, is_copy = where.get("start"), copied_archives.lacks_archive(hosted)
    if start is not None and is_copy:
        copied_archives.check_read(hosted, Query(interval=Interval(start, start)), now, horizon)
    place = VisibleAllCursor(hosted.channel, horizon, now, archived=is_copy or hosted.recording is not None, **where)
    return _AllModeCursor(group, hosted, place, RecordedSteps(channels, place))


def member_of(group: HostedGroup | CopiedGroup, hosted: HostedChannel) -> HostedChannel:
    """Return the channel. Raises InvalidArgument if the channel is not a member of the group."""
    if hosted.record.channel_id not in group.definition.members:
        raise InvalidArgument(
            f"channel {hosted.record.name} is not a member of group {group.record.name}; add it, or leave group_id out"
        )
    return hosted


def _state(group: HostedGroup, hosted: HostedChannel) -> object:
    """The facts on which the answers to gets depend. Equal values mean that a look gives the same answer as before."""
    return hosted.channel.next_seq, hosted.channel.advanced_to, group.cut.cut, group.generation


def _wanted(params: GroupReadParams) -> int | None:
    """The cut that the request needs; None: any."""
    return max((one for one in (params.floor, params.at) if one is not None), default=None)


def _left_s(deadline_s: float | None) -> float | None:
    return None if deadline_s is None else max(deadline_s - _now_s(), 0.0)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
