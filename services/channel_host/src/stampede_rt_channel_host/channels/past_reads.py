"""Reads of a recorded channel as of an earlier instant. They see the items that the host had accepted by then."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import NamedTuple, TypeVar

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.archive import (
    ArchivedRead,
    NextItems,
    PastArchive,
    PastFacts,
    Segment,
    is_nothing_left,
    nothing_left,
    past_moment,
    read_nothing,
    resolved,
    span_of,
)
from stampede_rt_channel_host.core.channel import ChannelCore, Query, ReadAnswer
from stampede_rt_channel_host.core.group import Horizon, RecordedView

Done = TypeVar("Done")
TRIES = 3  # how often a read is tried if the limits of the archive remove its segments meanwhile
RETRY_SECONDS = 0.02
ARCHIVED_WITHIN_SECONDS = 5.0  # the longest wait for items that are not archived yet


async def tried(read: Callable[[], Awaitable[Done]]) -> Done:
    """Perform a read of the archive. Raises Unavailable if the archive cannot be read."""
    for _ in range(TRIES):
        try:
            return await read()
        except FileNotFoundError:  # a segment has just left the archive
            await asyncio.sleep(RETRY_SECONDS)
        except OSError as error:
            raise Unavailable(f"the archive of the channel cannot be read: {error.strerror}; read again") from error
    raise Unavailable("the archive of the channel loses its oldest items faster than it is read; read later items")


class PastSummary(NamedTuple):
    """The highest advance at an earlier instant, when the channel next changed, and the items that came then.

    `next_items` is None if only the advance changed then. The other fields are None if there was no advance, or no
    later change yet.
    """

    advance: int | None
    next_change: int | None
    next_items: NextItems | None


class PastAnswer(NamedTuple):
    """The answer of a read. `continues`: the answer would be too long, so later items follow in the next one."""

    answer: ReadAnswer
    continues: bool
    summary: PastSummary


class PastReader:
    """Reads one channel only from its archive."""

    def __init__(self, archive: HostArchive, recorder: ChannelRecorder, channel: ChannelCore) -> None:
        self._archive = archive
        self._recorder = recorder
        self._channel = channel

    async def read(
        self, query: Query, as_of: int, scheduler: PieceScheduler, horizon: Horizon | None = None
    ) -> PastAnswer:
        """Read as of an instant of the host's clock that has passed. `horizon` is the horizon of the group
        through which the caller reads, if it reads through a group.

        First waits until the archive has all items that the host had accepted by then. Raises Unavailable if that takes
        more than ARCHIVED_WITHIN_SECONDS, or if the archive cannot be read.
        """
        self._channel.check_positions(query)
        await self._recorder.former.wait()
        await self._archived(as_of)
        return await tried(lambda: self._read(query, as_of, scheduler, horizon))

    async def _archived(self, as_of: int) -> None:
        """Wait until the archive has all items that the host had accepted by `as_of`."""
        tries = round(ARCHIVED_WITHIN_SECONDS / RETRY_SECONDS)
        while (since := self._recorder.waiting_since) is not None and since <= as_of:
            tries -= 1
            if tries < 0:
                raise Unavailable(
                    f"the archive does not have the items of that instant after {ARCHIVED_WITHIN_SECONDS} s; the disk "
                    "is full or too slow, read again later"
                )
            await asyncio.sleep(RETRY_SECONDS)

    async def _read(self, query: Query, as_of: int, scheduler: PieceScheduler, horizon: Horizon | None) -> PastAnswer:
        past, segments, begin = await self._past(as_of)
        summary = _summary(past)
        channel, span = self._channel, span_of(past.segments)
        facts = PastFacts(channel.policy, channel.incarnation, past.advance, channel.lost_before, channel.lost_from)
        moment = past_moment(facts, past, span, as_of)
        within = resolved(moment, span, query)
        has_dropped = span_of(segments, begin).has_dropped(channel.lost_before, channel.lost_from)
        if is_nothing_left(segments, past, has_dropped=has_dropped):
            return PastAnswer(nothing_left(segments, past, within, as_of, channel.incarnation), False, summary)
        if horizon is not None:
            view = await self._view(RecordedView(moment, span, query, horizon), past, scheduler)
            return PastAnswer(view.answer, view.continues, summary)
        if within is None or span.newest is None:
            return PastAnswer(await scheduler.do(read_nothing(moment, query, within)), False, summary)
        read = ArchivedRead(moment, span, query, within)
        await self._load(read, past, scheduler)
        return PastAnswer(read.answer(), read.continues, summary)

    async def _view(self, view: RecordedView, past: PastArchive, scheduler: PieceScheduler) -> RecordedView:
        for read in view.reads(None):
            await self._load(read, past, scheduler)
        return view

    async def _past(self, as_of: int) -> tuple[PastArchive, tuple[Segment, ...], int]:
        """The archive as of an instant, with the facts about the next change; all segments of the archive; and the seq
        with which it begins if it has no segments.
        """
        while True:
            recorder = self._recorder
            segments, since, begin = recorder.segments, recorder.waiting_since, recorder.archived_to
            past = await self._archive.past(self._recorder.files, segments, as_of)
            if since is None or past.next_items is not None or past.next_advance is not None:
                return past, segments, begin
            await self._archived(since)

    async def _load(self, read: ArchivedRead, past: PastArchive, scheduler: PieceScheduler) -> None:
        await scheduler.do(read.begin())
        while (wanted := read.next_window()) is not None:
            window = await self._archive.load(self._recorder.files, past.segments, wanted, past)
            await scheduler.do(read.take(window))


def _summary(past: PastArchive) -> PastSummary:
    items, advance = past.next_items, past.next_advance
    if items is not None and (advance is None or items.accepted <= advance):
        return PastSummary(past.advance, items.accepted, items)
    return PastSummary(past.advance, advance, None)
