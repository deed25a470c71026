"""The blocked gets of one channel through one group.

The host looks for the answer of a get again when the channel or the cut has reached the instant that the get needs.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels.gets.waiting_get import Outcome
from stampede_rt_channel_host.channels.gets.waiting_gets import WaitingGets
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.time_limits import TimeLimits
from stampede_rt_channel_host.core.channel import (
    BEFORE_ALL,
    ChannelSnapshot,
    PendingGet,
    Pieces,
    ReachTracker,
    ReadAnswer,
    UnfinishedWork,
    WakeAt,
)
from stampede_rt_channel_host.core.group import Horizon, VisibleChannel, polling
from stampede_rt_channel_host.groups.hosted_group import HostedGroup

Released = ReadAnswer | UnfinishedWork[ReadAnswer | WakeAt] | UnfinishedWork[ReadAnswer]


class PendingGroupGet(PendingGet):
    """A blocking get through a group.

    `at`: the cut at which the get reads; None: the present cut. `cut`: the cut at which the host last looked for the
    answer.
    """

    __slots__ = ("at", "cut")

    def __init__(self, pending: PendingGet, at: int | None) -> None:
        super().__init__(pending.query, pending.interval)
        self.at = at
        self.cut: int | None = None


class _GroupSnapshot:
    """The channel and the cut as they were at one moment."""

    def __init__(self, group: HostedGroup, snapshot: ChannelSnapshot) -> None:
        self._group = group
        self._snapshot = snapshot
        self._horizon = group.horizon()

    def polling(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """See `PolledSource`."""
        group_get = _group_get(pending)
        horizon = self._horizon if group_get.at is None else self._group.horizon(group_get.at)
        group_get.cut = horizon.cut
        return polling(self._snapshot, pending, horizon, self._snapshot.clock)

    def close(self) -> None:
        """See `SourceSnapshot`."""
        self._snapshot.close()


class GroupGets:
    """Observes the group and the channel while gets wait, as a `ChannelObserver`. Answers the gets, as a `Source`.

    `check` raises InvalidArgument if the channel is no longer a member. `scheduler` does long work in pieces. `limits`
    ends the waits of all gets of the host.
    """

    def __init__(
        self,
        group: HostedGroup,
        hosted: HostedChannel,
        now: Callable[[], int],
        check: Callable[[], object],
        scheduler: PieceScheduler,
        limits: TimeLimits,
    ) -> None:
        self._group = group
        self._scheduler = scheduler
        self._hosted = hosted
        self._now = now
        self._check = check
        self._view = VisibleChannel(hosted.channel)
        self.gets = WaitingGets(self, ReachTracker(hosted.channel), now, self._visible_to, scheduler.begin, limits)

    @classmethod
    def of(
        cls,
        group: HostedGroup,
        hosted: HostedChannel,
        now: Callable[[], int],
        check: Callable[[], object],
        scheduler: PieceScheduler,
        limits: TimeLimits,
    ) -> GroupGets:
        """The object that has the blocked gets of this channel through this group; a new one if no get waits."""
        waiting = group.gets.get(hosted)
        return waiting if isinstance(waiting, cls) else cls(group, hosted, now, check, scheduler, limits)

    async def wait(self, pending: PendingGroupGet, wake: WakeAt, wait_nanos: int) -> tuple[Released, int | None]:
        """Wait until the get, which was just polled, is released or `wait_nanos` are over; below 0: without limit.

        `wake`: the result of that poll. Returns the answer, or the rest of the work on a long answer, and the cut at
        which the get reads. Raises Overloaded if too many gets wait, the error that ends the group or the channel, and
        the error of `check`.
        """
        released: asyncio.Future[tuple[Released, int | None]] = asyncio.get_running_loop().create_future()

        def finish(outcome: Outcome) -> None:
            if released.done():
                return
            if isinstance(outcome, StampedeError):
                released.set_exception(outcome)
            else:
                released.set_result((outcome, pending.cut))

        get = self.gets.add(pending, wake, wait_nanos, self._now(), finish)
        self._group.gets[self._hosted] = self
        self._hosted.group_observers[self] = None
        self._hosted.group_gets[get] = None
        try:
            return await released
        finally:
            get.cancel()
            self._hosted.group_gets.pop(get, None)
            if not len(self.gets):
                self._leave()

    def polling(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """See `Source`."""
        return self._view.polling(pending, self._horizon(pending), now)

    def giving_up(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer]:
        """See `Source`."""
        return self._view.giving_up(pending, self._horizon(pending), now)

    def snapshot(self, now: int) -> _GroupSnapshot:
        """See `Source`."""
        return _GroupSnapshot(self._group, self._hosted.channel.snapshot(now))

    def wake(self) -> None:
        """Note that the channel has changed, or that the group shows more."""
        try:
            self._check()
        except StampedeError as error:
            self.end(error)
        else:
            self.gets.changed(self._now())

    def end(self, error: StampedeError) -> None:
        """Note that the host no longer serves the group or the channel."""
        self._leave()
        self._scheduler.begin(self.gets.ending(error))

    def _horizon(self, pending: PendingGet) -> Horizon:
        group_get = _group_get(pending)
        horizon = self._group.horizon(group_get.at)
        group_get.cut = horizon.cut
        return horizon

    def _leave(self) -> None:
        if self._group.gets.get(self._hosted) is self:
            del self._group.gets[self._hosted]
        self._hosted.group_observers.pop(self, None)

    def _visible_to(self) -> int:
        cut = self._group.horizon().cut
        return BEFORE_ALL if cut is None else cut


def _group_get(pending: PendingGet) -> PendingGroupGet:
    assert isinstance(pending, PendingGroupGet), "GroupGets holds only gets through the group"
    return pending
