"""Moves of channels to this host, which drives them: feed, hold, commit, release (paper, section 4.1)."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import NamedTuple, TypeVar

import grpc

from stampede_rt.errors import StaleBinding, StampedeError, Unavailable
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.copy_state import CopyState, Inheritance
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.name_log import NameLog
from stampede_rt_channel_host.copies.copy_feed import WINDOW_BYTES
from stampede_rt_channel_host.copies.keeper import CopyKeeper
from stampede_rt_channel_host.copies.moves.early_holds import EarlyHolds
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.move_feed import MoveFeed
from stampede_rt_channel_host.copies.moves.move_slots import MoveSlots
from stampede_rt_channel_host.copies.moves.move_streams import MoveStream, MoveStreams
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.core.records import RecordedChannel

Result = TypeVar("Result")
logger = logging.getLogger(__name__)

RELEASED_SECONDS_MAX = 1.0
ARCHIVED_SECONDS_MAX = 4.0  # puts wait meanwhile
HANDOFF_SECONDS_MAX = 4.0  # shorter than the source holds puts
RETRY_SECONDS_MIN, RETRY_SECONDS_MAX = 0.02, 1.0
WIDE_WINDOWS_MAX = 8  # further moves have NARROW_WINDOW_BYTES, so that all moves have 152 MiB at most
NARROW_WINDOW_BYTES = WINDOW_BYTES // 4


class MovedChannel(NamedTuple):
    """A channel that has moved here. `blackout_nanos`: the time for which puts waited; 0 if this host was the owner."""

    hosted: HostedChannel
    blackout_nanos: int


class IncomingMoves:
    """The moves to one host, on its event loop. `dial` opens connections to other hosts."""

    def __init__(
        self, identity: HostIdentity, store: ChannelStore, directory: MoveDirectory, keeper: CopyKeeper,
        dial: Callable[[str], grpc.aio.Channel], bytes_per_second: int = 0,
    ) -> None:  # fmt: skip
        """`bytes_per_second`: the most that each feed takes; 0: without a limit."""
        self._identity = identity
        self._store = store
        self._directory = directory
        self._keeper = keeper
        self._streams = MoveStreams(dial)
        self._bytes_per_second = bytes_per_second
        self._moves: dict[bytes, asyncio.Task[MovedChannel]] = {}  # by channel
        self._slots = MoveSlots(f"to host {identity.name}")
        self._early = EarlyHolds()
        self._moved = NameLog(logger, "channel", "moved here", event="channel_moved_here")
        self._is_closing = False

    async def move_here(
        self, record: RecordedChannel, source: FeedSource, *, is_of_drain: bool = False
    ) -> MovedChannel:
        """Make this host the owner of a channel, which `source` owns. Joins a move of this channel that is under way.

        `is_of_drain`: the source holds the channel early if it is idle, because other channels wait for their turn. The
        move continues if the caller is cancelled. Raises the errors of MigrationService.MoveHere.
        """
        if record.host_id == self._identity.host_id:
            return MovedChannel(await self._store.bind(record.channel_id, record.epoch), 0)
        return await asyncio.shield(self._moves.get(record.channel_id) or self._begin_move(record, source, is_of_drain))

    def _begin_move(self, record: RecordedChannel, source: FeedSource, is_of_drain: bool) -> asyncio.Task[MovedChannel]:
        if self._is_closing:
            raise refusals.SHUTTING_DOWN
        if not source.target:
            raise Unavailable(f"the host of channel {record.name} is lost, and so are its items; open the channel")
        self._store.recordings.check_move(record)
        self._slots.take(record)
        move = asyncio.create_task(self._move(record, source, is_of_drain), name=f"move of {record.name}")
        self._moves[record.channel_id] = move
        move.add_done_callback(lambda done: self._over(record, done))
        return move

    def _over(self, record: RecordedChannel, move: asyncio.Task[MovedChannel]) -> None:
        self._moves.pop(record.channel_id, None)
        self._slots.give_back(record)
        failure = None if move.cancelled() else move.exception()
        if failure is not None:
            logger.info("a move has failed", extra={"event": "move_failed", "why": str(failure)})

    def close(self) -> None:
        """Begin no further moves, because this host gives its channels away and stops."""
        self._is_closing = True

    async def ended(self) -> None:
        """Wait until no move is under way. Call `close` first."""
        while self._moves:
            await asyncio.wait([*self._moves.values()])

    async def aclose(self) -> None:
        """Give up all moves."""
        moves = [*self._moves.values()]
        for move in moves:
            move.cancel()
        await asyncio.gather(*moves, return_exceptions=True)
        await self._streams.aclose()
        self._moved.close()

    def _may_hold_early(self, record: RecordedChannel, source: FeedSource) -> bool:
        """Whether the source may hold the channel before this host asks it to do so.

        Puts must not wait for an archive or for a slow copy.
        """
        is_slow = bool(self._bytes_per_second) or not self._early.may_hold(source.target, time.monotonic())
        return not (is_slow or record.policy.is_recorded or record.policy.replicas)

    async def _move(self, record: RecordedChannel, source: FeedSource, is_of_drain: bool) -> MovedChannel:
        state = self._keeper.pause(record.channel_id)
        is_early = is_of_drain and self._may_hold_early(record, source)
        feed = MoveFeed(
            self._store, record, state, self._identity.host_id, self._keeper.target, self._bytes_per_second,
            WINDOW_BYTES if self._slots.under_way <= WIDE_WINDOWS_MAX else NARROW_WINDOW_BYTES,
            may_hold_early=is_early,
        )  # fmt: skip
        feeding = asyncio.create_task(self._feed(feed, source), name=f"feed of {record.name}")
        try:
            return await self._take_over(record, source, state, feed, feeding)
        finally:
            if is_early:
                self._early.note_wait(source.target, feed.last_message_seconds, time.monotonic())
            feeding.cancel()
            await asyncio.gather(feeding, return_exceptions=True)
            self._keeper.resume(record, state)
            self._store.recordings.give_up(record.channel_id)

    async def _feed(self, feed: MoveFeed, source: FeedSource) -> None:
        """Feed the copy until the move is over. A stream of earlier moves may have broken; then uses a new one."""
        stream = self._streams.free(source.target)
        try:
            await self._feed_over(stream, feed, source)
        except Unavailable:
            if stream.is_new or feed.is_opened:
                raise
            await self._feed_over(self._streams.new(source.target), feed, source)

    async def _feed_over(self, stream: MoveStream, feed: MoveFeed, source: FeedSource) -> None:
        is_free = False
        try:
            await feed.run_over(stream.call, source)
            is_free = True
        finally:
            await self._streams.give_back(stream, is_free=is_free)

    async def _take_over(
        self, record: RecordedChannel, source: FeedSource, state: CopyState, feed: MoveFeed, feeding: asyncio.Task[None]
    ) -> MovedChannel:
        await _unless_ended(feeding, feed.caught_up)
        if not feed.handoff.done():
            await self._prepare_archive(record, state)
            feed.hold()
        inheritance = await _handoff(record.name, feed, feeding)
        await self._prepare_archive(record, state)  # the policy may have changed before the changes were held
        state.may_inherit = inheritance
        request_id = secrets.token_bytes(16)
        commit = partial(self._directory.commit, record.channel_id, source.epoch, request_id, feed.permit)
        committed = await until_known(commit)
        hosted = await self._store.recordings.adopt(committed, self._store.known(record.channel_id), self._store.adopt)
        feed.committed(hosted.epoch)
        await self._archived(hosted)
        await self._remove_fallback(hosted)
        blackout_nanos = time.monotonic_ns() - feed.held_nanos
        hosted.end_move()
        feed.released()
        await asyncio.wait({feeding}, timeout=RELEASED_SECONDS_MAX)  # so that the source learns that the move is over
        self._moved.note(record.name)
        return MovedChannel(hosted, blackout_nanos)

    async def _prepare_archive(self, record: RecordedChannel, state: CopyState) -> None:
        """Open the archive of a recorded channel, unless it is open. Raises InvalidArgument and Unavailable."""
        copy = self._store.copies.of(record.channel_id)
        present = record if copy is None else copy.record
        self._store.recordings.check_move(present)
        await self._store.recordings.prepare_move(present, state.source_next_seq)

    async def _archived(self, hosted: HostedChannel) -> None:
        """Have the archive of this host write the items. Wait for it if puts of the channel wait for a disk, or if the
        archive has earlier items: until the write, the answers to readers do not name the hole between these and the
        moved items.

        Meanwhile the former owner is the fallback, with the items on its disk. Waits ARCHIVED_SECONDS_MAX at most.
        """
        if hosted.recording is None:
            return
        hosted.changed(self._store.now())  # the recorder notes the items
        if hosted.record.policy.ack == "disk" or hosted.recording.recorder.segments:
            hosted.recording.hurry()
            held = next(iter(hosted.core.accepted_from(0)), None)
            first_seq = hosted.core.next_seq if held is None else held.first_seq
            why = await hosted.recording.recorder.stored(first_seq, hosted.core.next_seq, ARCHIVED_SECONDS_MAX)
            if why:
                extra = {"event": "move_not_archived", "channel": hosted.record.name, "why": why}
                logger.warning("the archive has not all items of a channel that has moved here", extra=extra)

    async def _learn_owner(self, hosted: HostedChannel) -> None:
        """Drop a channel that another host owns: this host was registered anew before it knew that its move was
        committed.
        """
        with suppress(StampedeError):
            present = await self._directory.resolve(hosted.record.channel_id)
            if present.host_id != self._identity.host_id and self._store.known(present.channel_id) is hosted:
                self._store.forget(present.channel_id, refusals.moved(present.name, present.host_id))

    async def _remove_fallback(self, hosted: HostedChannel) -> None:
        """Remove the former owner as the fallback. Tries again for as long as this host has the channel.

        If this host had a replica, the former owner has taken its place, and stays there. Raises Unavailable if this
        host has lost the channel meanwhile.
        """
        delay_s = RETRY_SECONDS_MIN
        while self._store.known(hosted.record.channel_id) is hosted:  # paced by the sleep
            try:
                return await self._directory.remove_fallback(hosted.record.channel_id, hosted.record.epoch)
            except StaleBinding:
                await self._learn_owner(hosted)
                break
            except StampedeError as error:
                extra = {"event": "move_undecided", "channel": hosted.record.name, "why": str(error)}
                logger.info("cannot tell the directory that a move is over; the host tries again", extra=extra)
            await asyncio.sleep(delay_s)
            delay_s = min(2 * delay_s, RETRY_SECONDS_MAX)
        raise Unavailable(
            f"host {self._identity.name} has lost channel {hosted.record.name} at the end of its move; look where the "
            f"channel is (`stampede info {hosted.record.name}`), and move it again"
        )


async def until_known(commit: Callable[[], Awaitable[Result]]) -> Result:
    """Have the directory commit a move. Asks until this host knows the outcome, because the former owner waits for it.

    Raises StaleBinding (WRONG_EPOCH) if the former owner has ended the move, and other errors that a repetition cannot
    cure.
    """
    delay_s = RETRY_SECONDS_MIN
    while True:  # paced by the sleep; ends when the directory answers
        try:
            return await commit()
        except StampedeError as error:
            if isinstance(error, StaleBinding) or not error.retryable:
                raise
        await asyncio.sleep(delay_s)
        delay_s = min(2 * delay_s, RETRY_SECONDS_MAX)


async def _handoff(name: str, feed: MoveFeed, feeding: asyncio.Task[None]) -> Inheritance:
    """Wait until the source has handed the channel over. Raises Unavailable after HANDOFF_SECONDS_MAX."""
    try:
        async with asyncio.timeout(HANDOFF_SECONDS_MAX):
            return await _unless_ended(feeding, feed.handoff)
    except TimeoutError:
        text = f"the host of channel {name} did not hand it over in {HANDOFF_SECONDS_MAX:g} s; move it again"
        raise Unavailable(text) from None


async def _unless_ended(feeding: asyncio.Task[None], wanted: asyncio.Future[Result]) -> Result:
    """The result of `wanted`. Raises the error of the feed if the feed ends first."""
    try:
        await asyncio.wait((feeding, wanted), return_when=asyncio.FIRST_COMPLETED)
        if not wanted.done():
            await feeding
            raise Unavailable("the feed of a move has ended early")
        return wanted.result()
    finally:
        wanted.cancel()
