"""Records one hosted channel: passes accepted items to the archive, and reads the archive and memory together."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from typing import Any

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.values.policy import FOREVER_NANOS
from stampede_rt.values.seq_starts import has_start, is_start, start_of
from stampede_rt.values.timeline import Bound, Interval, Match, ResolvedInterval
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from stampede_rt_channel_host.channels.archive_reach import ArchiveReach
from stampede_rt_channel_host.channels.archive_status import archive_status
from stampede_rt_channel_host.channels.archived_losses import ArchivedLosses
from stampede_rt_channel_host.channels.opened_archives import OpenedChannelArchive
from stampede_rt_channel_host.channels.past_reads import RETRY_SECONDS, TRIES, PastReader, tried
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.restored_channel import lacks_loss, restore_channel, restore_instants
from stampede_rt_channel_host.channels.unknown_past import UnknownPast
from stampede_rt_channel_host.core.archive import (
    ArchivedPart,
    ArchivedRead,
    ArchiveWindow,
    Hole,
    WantedWindow,
    deliver,
    lacked,
    next_time_of,
    resolved,
)
from stampede_rt_channel_host.core.channel import (
    FIRST_KEY,
    AllCursor,
    ChannelCore,
    Pieces,
    Query,
    Slice,
    SubscriptionBatch,
)
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.group import Horizon, RecordedView

ENTRIES_PER_LOOK = 1024


class Recording:
    """Records one channel from its start at this host. Calls `on_archived` after each write that succeeds."""

    def __init__(
        self,
        archive: HostArchive,
        opened: OpenedChannelArchive,
        channel: ChannelCore,
        cut: Callable[[bytes, int, int], bytes],
        on_archived: Callable[[], None],
        *,
        from_memory: bool = False,
    ) -> None:
        """`from_memory`: also write the items that the channel holds already, if the archive lacks them."""
        self.is_stopped = False
        self.is_settled: Callable[[], bool] = lambda: True
        """Whether readers see all items that the channel has accepted, so that no more can come to the archive."""
        self._archive = archive
        self._channel = channel
        self._on_archived = on_archived
        # None if the host knows which items the object store has
        self._unknown = None if opened.files.is_known else UnknownPast(channel, opened.files.epoch, opened.found)
        begin = start_of(opened.files.epoch) if has_start(opened.files.epoch) else 1
        found_to: int | None = None
        if channel.next_seq == 1 and not from_memory:  # a move also brings the state without items
            found_to = restore_channel(channel, opened.found, opened.newest, cut, begin)
            restore_instants(channel, opened.newest, archive.now())
        self.recorder = ChannelRecorder(
            channel, opened.files, opened.found.segments, opened.disk, from_memory=from_memory
        )
        self._reach = ArchiveReach(self.recorder, channel)
        self.losses = ArchivedLosses(archive, self.recorder, self._reach, channel)
        held = channel.held
        # the times of the latest items that the archive will not have
        earlier = [held.newest_collected, *([] if from_memory else [held.newest])]
        opened.files.earlier = max([opened.files.earlier, *((one, 1) for one in earlier if one is not None)])
        if from_memory and is_start(channel.next_seq):  # the former owner accepted no item, and so wrote no loss
            found_to = max((one.end_seq for one in opened.found.segments), default=1)
        notes_loss = not from_memory or found_to is not None
        if notes_loss and lacks_loss(channel.lost_before, opened.found):
            self.recorder.note_loss(channel.lost_before, found_to)
        self.recorder.on_listed = self._listed
        archive.record(self.recorder, has_moved=from_memory)

    def set_policy(self, policy: Policy, epoch: int = 0) -> None:
        """Take over the limits of the archive, and the epoch of the channel at this host."""
        self.recorder.files.raise_epoch(epoch)
        age = None if policy.archive_nanos == FOREVER_NANOS else policy.archive_nanos
        self.recorder.limit(ArchiveLimits(age, policy.archive_bytes))

    def accepted(self, now: int) -> None:
        """Note that the channel has accepted items or an advance at `now`."""
        if self.recorder.note(now):
            self._archive.touch(self.recorder, self._written)

    def _listed(self, stop: CleanStop | None) -> None:
        if self._unknown is not None:
            self._unknown.listed(stop)
            self._written()

    def _written(self) -> None:
        if self._unknown is not None and self._unknown.is_over(self.recorder, self._archive.now()):
            # if a clean stop of the former owner has turned up, reads wait until no file reports a loss
            if self._channel.lost_before is None and self.recorder.withdraw_loss():
                self._archive.touch(self.recorder, self._written)
            else:
                self._unknown = None
        self._on_archived()

    def check_advance(self, instant: int) -> None:
        """Check that the archive has room for an advance to `instant`, unless it changes nothing. Raises Overloaded."""
        before = self._channel.advanced_to
        if before is None or instant > before:
            self.recorder.check_room()

    def hurry(self) -> None:
        """Write immediately, because a put waits for stable storage."""
        self._archive.hurry()

    def status(self) -> Pieces[channel_pb2.ArchiveStatus]:
        """The status of the archive, made in pieces."""
        return archive_status(self.recorder, self._archive)

    def stop(self) -> None:
        """Stop writing, because the host gives the channel up."""
        if not self.is_stopped:
            self.is_stopped = True
            self._archive.forget(self.recorder)

    def reaches(self, query: Query, now: int) -> bool:
        """Whether a read may need items that only the archive has."""
        if self._unknown is not None and self._unknown.hides(self.recorder, query, now):
            return True
        return self._reach.includes(query, now)

    @property
    def may_read(self) -> bool:
        """Whether the archive may have items, see `ArchiveReach`."""
        return self._reach.may_read

    @property
    def kept_from(self) -> int:
        """The lowest seq of an item in the archive or in memory, see `ArchiveReach`."""
        return self._reach.kept_from

    @property
    def is_past_known(self) -> bool:
        """Whether the host knows which items the archive has."""
        return self._unknown is None

    async def read(
        self, query: Query, within: ResolvedInterval | None, scheduler: PieceScheduler, now: Callable[[], int]
    ) -> ArchivedRead:
        """Read the archive and memory together. `within`: the resolved interval; None: it is not resolved yet.

        Raises Unavailable if the archive cannot be read.
        """
        self._channel.check_positions(query)
        self.check_known(query, now())
        await self._settle()
        return await tried(lambda: self._read(query, within, scheduler, now()))

    def check_known(self, query: Query, now: int, horizon: Horizon | None = None) -> None:
        """Raise Unavailable if a read needs items of the object store, and the host does not know them yet."""
        if self._unknown is not None:
            self._unknown.check(self.recorder, query, now, horizon)

    def check_movable(self) -> None:
        """Raise Unavailable if a new owner could not know that the object store has earlier items."""
        if self._unknown is not None:
            raise self._unknown.move_error()

    def check_start(self, start: Bound, now: int, horizon: Horizon | None = None) -> None:
        """Raise Unavailable if a reader that begins at `start` needs unknown items; see `check_known`."""
        self.check_known(Query(interval=Interval(start, start), match=Match.START), now, horizon)

    def reaches_in_group(self, query: Query, horizon: Horizon, now: int) -> bool:
        """Whether a read through a group may need items that only the archive has."""
        if self._unknown is not None and self._unknown.hides(self.recorder, query, now, horizon):
            return True
        return self._reach.includes_in_group(query, horizon, now)

    async def read_in_group(
        self, query: Query, horizon: Horizon, within: ResolvedInterval | None, scheduler: PieceScheduler,
        now: Callable[[], int], *, waits: bool,
    ) -> RecordedView:  # fmt: skip
        """Read the items before a cut, over the archive and memory. `waits`: see `RecordedView.reads`.

        Raises Unavailable if the archive cannot be read.
        """
        self._channel.check_positions(query)
        self.check_known(query, now(), horizon)
        await self._settle()
        return await tried(lambda: self._read_in_group(query, horizon, within, scheduler, now(), waits=waits))

    def past_reader(self) -> PastReader:
        """Reads the channel as it was at earlier instants. Raises Unavailable as `check_known`."""
        if self._unknown is not None:
            raise self._unknown.error()
        return PastReader(self._archive, self.recorder, self._channel)

    def beginning(self, where: dict[str, Any], now: int) -> dict[str, Any]:
        """The place where a subscription begins. If its start is a meta-time, it is resolved over archive and memory.

        `where` are keyword arguments of `ChannelCore.subscribing_all`. Raises Unavailable as `check_known`.
        """
        start = where.get("start")
        if start is not None:
            self.check_start(start, now)
        if start is None or not self.may_read:
            return where
        found = self._reach.resolved_start(Query(interval=Interval(start, start)), now)
        if found is None:
            return where
        begin, archived_from = found
        where = {**where, "start": Bound(None, begin)}
        return where if archived_from is None else {**where, "archived_from": archived_from}

    async def settle_start(self, start: Bound, now: int) -> None:
        """Wait until a subscription can begin at `start`, because a file of the former owner may have the first items.

        Call it before `beginning`.
        """
        if self.recorder.former.are_expected and self.reaches(Query(interval=Interval(start, start)), now):
            await self.recorder.former.wait()

    async def _settle(self) -> None:
        """Wait for items that are on their way to the archive: from a former owner, or from memory."""
        await self.recorder.former.wait()
        await self.recorder.settle(self._channel.next_seq)

    async def since(self, cursor: AllCursor, limit_bytes: int, now: Callable[[], int]) -> SubscriptionBatch | None:
        """The next part of a subscription if memory does not have it; otherwise None. Moves the cursor.

        Raises Unavailable if the archive cannot be read.
        """
        missing = self._channel.missing(cursor, now())
        if missing is not None and self.recorder.former.are_expected:
            await self.recorder.former.wait()
            missing = self._channel.missing(cursor, now())
        if missing is not None and missing[0] >= self.recorder.archived_to:
            await self.recorder.settle(missing[1])
            missing = self._channel.missing(cursor, now())
        if missing is not None and cursor.losses:  # the reader learns of the next loss between the items
            end = min(missing[1], cursor.losses[0].next_seq)
            missing = (missing[0], end) if missing[0] < end else None
        if missing is None:
            return None
        if missing[0] >= self.recorder.archived_to:  # memory has lost the items before a write had them
            return None if cursor.losses else lacked(cursor, missing)
        missing = missing[0], min(missing[1], self.recorder.archived_to)
        part = await self._load_part(missing, limit_bytes)
        held, _ = self._channel.look(now())
        segments = self.recorder.segments
        kept_from = segments[0].first_seq if segments else self.recorder.archived_to
        return deliver(cursor, missing, part, held.next_time, kept_from, limit_bytes)

    async def items_from(
        self, seqs: tuple[int, int], bytes_max: int, now: Callable[[], int]
    ) -> tuple[Iterable[Slice], Callable[[int], int | None], int]:
        """The first items with these seqs that memory or the archive has.

        Returns the items, a function that returns the time of the next bucket after a time, and a seq: the search has
        covered all lower seqs. Raises Unavailable if the archive cannot be read.
        """
        held, _ = self._channel.look(now())
        end = held.held_up_to(*seqs, ENTRIES_PER_LOOK)
        if end == seqs[0] and end >= self.recorder.archived_to:
            await self.recorder.settle(seqs[1])
            held, _ = self._channel.look(now())
            end = held.held_up_to(*seqs, ENTRIES_PER_LOOK)
        if end == seqs[0] and end < self.recorder.archived_to:
            await self.recorder.former.wait()
            part = await self._load_part((end, min(seqs[1], self.recorder.archived_to)), bytes_max)
            held, _ = self._channel.look(now())
            return part.items.slices_by_seq(*seqs, FIRST_KEY), partial(next_time_of, part, held.next_time), part.end_seq
        end = seqs[1] if end == seqs[0] else end
        return held.slices_by_seq(seqs[0], end), held.next_time, end

    async def _load_part(self, missing: tuple[int, int], limit_bytes: int) -> ArchivedPart:
        for tries_left in reversed(range(TRIES)):
            try:
                return await self._archive.load_part(self.recorder.files, self.recorder.segments, missing, limit_bytes)
            except OSError as error:
                if tries_left and isinstance(error, FileNotFoundError):  # a segment has just left the archive
                    await asyncio.sleep(RETRY_SECONDS)
                    continue
                raise Unavailable(
                    f"the archive of the channel cannot be read: {error.strerror}; subscribe again"
                ) from error
        raise AssertionError("the last try returns or raises")

    async def _read(
        self, query: Query, within: ResolvedInterval | None, scheduler: PieceScheduler, now: int
    ) -> ArchivedRead:
        snapshot, windows = self._channel.snapshot(now), self._windows()
        try:
            span = self._reach.span
            within = within or resolved(snapshot, span, query)
            assert within is not None, "there is at least one item"
            return await self._perform(ArchivedRead(snapshot, span, query, within), windows, scheduler)
        finally:
            snapshot.close()

    async def _read_in_group(
        self, query: Query, horizon: Horizon, within: ResolvedInterval | None, scheduler: PieceScheduler, now: int,
        *, waits: bool,
    ) -> RecordedView:  # fmt: skip
        snapshot, windows = self._channel.snapshot(now), self._windows()
        try:
            view = RecordedView(snapshot, self._reach.span, query, horizon)
            for read in view.reads(within, waits=waits):
                await self._perform(read, windows, scheduler)
            return view
        finally:
            snapshot.close()

    async def _perform(
        self, read: ArchivedRead, load: Callable[[WantedWindow], Awaitable[ArchiveWindow]], scheduler: PieceScheduler
    ) -> ArchivedRead:
        await scheduler.do(read.begin())
        while (wanted := read.next_window()) is not None:
            window = await load(wanted)
            await scheduler.do(read.take(window))
        return read

    def _windows(self) -> Callable[[WantedWindow], Awaitable[ArchiveWindow]]:
        """A function that loads windows of the archive as it is now."""
        recorder = self.recorder
        if recorder.segments:
            return partial(self._archive.load, recorder.files, recorder.readable_segments)
        times = self._channel.backlog.lost_times
        holes = [] if times is None else [Hole(*times, recorder.lost_items)]
        return partial(_nothing_but, ArchiveWindow(ChannelIndex(), None, None, None, holes))


async def _nothing_but(window: ArchiveWindow, _: WantedWindow) -> ArchiveWindow:
    """Return `window`, for a read of an archive that has no items yet."""
    return window
