"""Keeps tracks of channels up to date by reads without payloads, as often as pages ask for drawings of them.

A page asks for the drawing of each channel that it shows several times a second. The server then reads the items that
came since its last read of the channel. One read serves all pages.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import Iterable

from stampede_rt import ChannelNotFound, ChannelStats, Items, StampedeError, aio
from stampede_rt.values.timeline import NEWEST, OLDEST
from stampede_rt_web.drawing import Window
from stampede_rt_web.track import ITEMS_MAX, ItemTrack, Mark, TrackItem
from stampede_rt_web.window_cache import WindowCache

PAGE_ITEMS = 4096  # the most items of one read
TRACKS_MAX = 64
REFRESH_NANOS = 150_000_000  # the least time between two reads of one channel
REACH_NANOS = 5_000_000_000  # the least time between two reads of a recorded channel's oldest item


class FollowedChannel:
    """One channel's handle and track, and the state of the reads that fill the track.

    `archive_oldest` is the time of a recorded channel's oldest item, in its archive or in memory. It is None if the
    channel is not recorded, or has no item.
    """

    def __init__(self, channel: aio.Channel) -> None:
        self.channel = channel
        self.track = ItemTrack()
        self.failure = ""
        self.archive_oldest: int | None = None
        self.is_gone = False  # the channel was deleted; a new channel of the same name needs another handle
        self._lock = asyncio.Lock()
        self._read_at = 0
        self._newest: int | None = None  # None: the first read has not ended yet
        self._reaches_oldest = False
        self._windows = WindowCache()
        self._reach_due = 0
        self._refused: dict[str, int] | None = None

    async def refresh(self, window: Window, stats: ChannelStats | None) -> None:
        """Read the new items, and older ones if the window begins before the track.

        If the window ends before the track, read only the first PAGE_ITEMS items, and keep them apart from the track.

        Does nothing within REFRESH_NANOS after the last call that read. If a read fails, the track stays as it is, and
        `failure` says why.
        """
        async with self._lock:
            now = time.time_ns()
            if now - self._read_at < REFRESH_NANOS:
                return
            self._read_at = now
            try:
                await self._read_newer(now, stats)
                if self._is_after(window):
                    await self._read_window(window, now)
                elif self._begins_after(window.start):
                    await self._read_older()
                await self._read_reach(now, stats)
                self.failure = ""
            except StampedeError as error:
                self.failure, self.is_gone = error.message, isinstance(error, ChannelNotFound)
        if stats is not None:
            self._note_refusals(stats)

    def track_for(self, window: Window) -> ItemTrack:
        """Return the track that has the items of the window."""
        track = self._windows.track_of(window) if self._is_after(window) else None
        return self.track if track is None else track

    def _is_after(self, window: Window) -> bool:
        track = self.track
        has_older = not self._reaches_oldest or len(track) >= ITEMS_MAX
        return bool(track) and has_older and track.times[0] > window.end

    def _begins_after(self, start: int) -> bool:
        track = self.track
        return bool(track) and not self._reaches_oldest and len(track) < ITEMS_MAX and track.times[0] > start

    async def _read_newer(self, now: int, stats: ChannelStats | None) -> None:
        if self._newest is None:
            found = await self.channel.get(
                OLDEST, NEWEST, match="start", limit=PAGE_ITEMS, newest_first=True, payloads=False
            )
            self.track.begin_incarnation(found.incarnation, now)
            self.track.prepend(reversed(list(_facts(found))))
            self._reaches_oldest = not found.more
        else:
            found = await self.channel.get(
                OLDEST, NEWEST, match="start", after=self._newest, limit=PAGE_ITEMS, payloads=False
            )
            self.track.begin_incarnation(found.incarnation, now)
            self.track.extend(_facts(found))
            if stats is not None and not found and stats.incarnation == self.track.incarnation:
                self.track.expect(stats.accepted)
            if self.track.has_missing:
                await self._read_late(now)
        if self.track:
            self._newest = self.track.times[-1]

    async def _read_late(self, now: int) -> None:
        recent = await self.channel.get(
            OLDEST, NEWEST, match="start", limit=PAGE_ITEMS, newest_first=True, payloads=False
        )
        self.track.add_late(_facts(recent), now)

    async def _read_older(self) -> None:
        older = await self.channel.get(
            OLDEST,
            NEWEST,
            match="start",
            after=self.track.times[0],
            limit=PAGE_ITEMS,
            newest_first=True,
            payloads=False,
        )
        self.track.prepend(reversed(list(_facts(older))))
        self._reaches_oldest = not older.more

    async def _read_window(self, window: Window, now: int) -> None:
        if not self._windows.is_due(window, now):
            return
        found = await self.channel.get(window.start, window.end, limit=PAGE_ITEMS, payloads=False)
        track = ItemTrack()
        track.prepend(_facts(found))
        track.ends_early = found.more
        self._windows.keep(window, track, now)

    async def _read_reach(self, now: int, stats: ChannelStats | None) -> None:
        policy = self.channel.info.policy if stats is None else stats.policy
        if not policy.is_recorded:
            self.archive_oldest = None
        elif now >= self._reach_due:
            self._reach_due = now + REACH_NANOS
            found = await self.channel.get(OLDEST, NEWEST, match="start", limit=1, payloads=False)
            self.archive_oldest = found[0].time if found else None

    def _note_refusals(self, stats: ChannelStats) -> None:
        rejected = dict(stats.rejected)
        for reason, count in rejected.items():
            more = count - (self._refused or {}).get(reason, 0)
            if self._refused is not None and more > 0:
                items = "1 item" if more == 1 else f"{more} items"
                self.track.marks.append(Mark(stats.host_time, "refused", f"The host refused {items}: {reason}."))
        self._refused = rejected


class FollowedChannels:
    """The channels that pages show, by name.

    Above TRACKS_MAX, forgets the least recently shown channel.
    """

    def __init__(self) -> None:
        self._followed: OrderedDict[str, FollowedChannel] = OrderedDict()

    async def channel(self, rt: aio.Connection, name: str) -> FollowedChannel:
        """Return the followed channel `name`. Raises ChannelNotFound, PermissionDenied, Unavailable."""
        found = self._followed.get(name)
        if found is None:
            found = self._followed.setdefault(name, FollowedChannel(await rt.channel(name, create=False)))
        self._followed.move_to_end(name)
        while len(self._followed) > TRACKS_MAX:
            self._followed.popitem(last=False)
        return found

    def forget(self, name: str) -> None:
        """Forget a channel, because it was deleted."""
        self._followed.pop(name, None)


def _facts(items: Items) -> Iterable[TrackItem]:
    for item in items:
        duration = -1 if item.duration is None else item.duration
        yield TrackItem(item.time, duration, item.seq, item.payload_length_bytes)
