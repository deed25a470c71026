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

PAGE_ITEMS = 4096  # the most items of one read
TRACKS_MAX = 64
REFRESH_NANOS = 150_000_000  # the least time between two reads of one channel


class FollowedChannel:
    """One channel's handle and track, and the state of the reads that fill the track."""

    def __init__(self, channel: aio.Channel) -> None:
        self.channel = channel
        self.track = ItemTrack()
        self.failure = ""
        self.is_gone = False  # the channel was deleted; a new channel of the same name needs another handle
        self._lock = asyncio.Lock()
        self._read_at = 0
        self._newest: int | None = None  # None: the first read has not come yet
        self._reaches_oldest = False
        self._refused: dict[str, int] | None = None

    async def refresh(self, window: Window, stats: ChannelStats | None) -> None:
        """Read the new items, and older ones if the window begins before the track.

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
                if self._begins_after(window.start):
                    await self._read_older()
                self.failure = ""
            except StampedeError as error:
                self.failure, self.is_gone = error.message, isinstance(error, ChannelNotFound)
        if stats is not None:
            self._note_refusals(stats)

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

    Beyond TRACKS_MAX, forgets the channel that no page has shown for longest.
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
