"""The cursors of subscriptions without a group."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.timeline import Interval
from stampede_rt_channel_host.channels import copied_archives
from stampede_rt_channel_host.channels.group_access import Cursor
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.channels.requests import beginning_of, is_newest
from stampede_rt_channel_host.core.channel import (
    AllCursor,
    ChannelCore,
    NewestCursor,
    Pieces,
    Query,
    SavedCursor,
    SubscriptionBatch,
)


class _AllModeCursor:
    """The cursor of a subscription in SUBSCRIBE_MODE_ALL."""

    skipped = 0

    def __init__(self, channel: ChannelCore, cursor: AllCursor) -> None:
        self._channel = channel
        self._cursor = cursor

    @property
    def saved(self) -> SavedCursor:
        return self._cursor.saved(self._channel.incarnation)

    async def from_archive(
        self, recording: Recording, limit_bytes: int, now: Callable[[], int]
    ) -> SubscriptionBatch | None:
        return await recording.since(self._cursor, limit_bytes, now)

    def is_held(self, now: int) -> bool:
        return self._channel.missing(self._cursor, now) is None

    def take(self, now: int, limit_bytes: int) -> SubscriptionBatch:
        return self._channel.since(self._cursor, now, limit_bytes)

    def progress(self, now: int) -> pb.SubscriptionProgress:
        return pb.SubscriptionProgress(next_seq=self._cursor.next_seq, dropped=self._cursor.dropped)


class _NewestModeCursor:
    """The cursor of a subscription in SUBSCRIBE_MODE_NEWEST."""

    def __init__(self, channel: ChannelCore, cursor: NewestCursor) -> None:
        self._channel = channel
        self._cursor = cursor

    @property
    def saved(self) -> SavedCursor:
        return self._cursor.saved(self._channel.incarnation)

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
        latest = self._channel.latest(self._cursor, now)
        return SubscriptionBatch(slices=(latest,) if latest else (), gap=self._cursor.take_loss())

    def progress(self, now: int) -> pb.SubscriptionProgress:
        return pb.SubscriptionProgress(next_seq=self._cursor.next_seq, skipped=self._cursor.skipped)


async def files_came(hosted: HostedChannel, opening: pb.SubscribeOpen, now: int) -> None:
    """Wait until the files of a former owner have come that may have the first items. Call it before `open_cursor`."""
    start = beginning_of(opening).get("start")
    if hosted.recording is not None and start is not None and not is_newest(opening):
        await hosted.recording.settle_start(start, now)


async def losses_at(hosted: HostedChannel, opening: pb.SubscribeOpen, now: int) -> list[int]:
    """The places of the losses that the reader does not know, see `ArchivedLosses`. Call it before `open_cursor`."""
    if hosted.recording is None or is_newest(opening):
        return []
    return await hosted.recording.losses.places(beginning_of(opening), now)


def open_cursor(
    hosted: HostedChannel, opening: pb.SubscribeOpen, now: int, lost_at: Iterable[int] = ()
) -> Pieces[Cursor]:
    """A cursor at the place that `opening` states, as of `now`, made in pieces. `lost_at`: see `losses_at`.

    Raises InvalidArgument for an unusable place, IncarnationLost for a place of another incarnation, and StaleBinding
    (MOVED) if only the owner has the archive of the first items.
    """
    where, channel = beginning_of(opening), hosted.channel
    if is_newest(opening):
        return _NewestModeCursor(channel, channel.subscribe_newest(now, **where))
    start = where.get("start")
    if hosted.recording is not None:
        where = hosted.recording.beginning(where, now)
    elif start is not None:
        copied_archives.check_read(hosted, Query(interval=Interval(start, start)), now)
    return _AllModeCursor(channel, (yield from channel.subscribing_all(now, **where, lost_at=lost_at)))
