"""Moves of channels away from this host: holds their changes, and ends moves that fail (paper, section 4.1)."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Coroutine
from typing import Any

from stampede_rt.errors import ChannelNotFound, StaleBinding, StampedeError
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.move_under_way import HELD_SECONDS_MAX, MoveUnderWay
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.name_log import NameLog
from stampede_rt_channel_host.copies.keeper import CopyKeeper
from stampede_rt_channel_host.copies.moves.allowed_moves import AllowedMoves
from stampede_rt_channel_host.copies.moves.move_directory import FormerOwnerRole, MoveDirectory
from stampede_rt_channel_host.copies.moves.move_slots import MoveSlots

logger = logging.getLogger(__name__)

RETRY_SECONDS = 0.2
FALLBACK_SECONDS = 2.0  # a former owner asks the directory at this interval whether its items are still needed


class OutgoingMoves:
    """The moves away from one host, on its event loop."""

    def __init__(
        self, identity: HostIdentity, store: ChannelStore, directory: MoveDirectory, keeper: CopyKeeper
    ) -> None:
        """This host may become a replica of a channel that has moved away. `keeper` then feeds this replica."""
        self.keeper = keeper
        self.identity = identity
        self.store = store
        self.directory = directory
        self.allowed = AllowedMoves(identity.move_key)
        self._slots = MoveSlots(f"away from host {identity.name}")
        self._tasks: set[asyncio.Task[None]] = set()
        self.moved = NameLog(logger, "channel", "moved away", event="channel_moved_away")

    def begin(self, hosted: HostedChannel, host_id: bytes, target: str) -> OutgoingMove:
        """Begin a move to the host `host_id`, whose gatekeeper is at `target`. Raises the errors of `check`."""
        self.check(hosted, host_id)
        self._slots.take(hosted.record)
        return OutgoingMove(self, hosted, hosted.begin_move(), host_id, target)

    def check(self, hosted: HostedChannel, host_id: bytes) -> None:
        """Raises PermissionDenied if no caller has allowed the move to that host, MoveConflict if the channel cannot
        move now, and Overloaded if too many move. Raises Unavailable if too few of its replicas are in sync, or if this
        host does not know yet which of its items the object store has.
        """
        record = hosted.record
        self.allowed.check(f"channel {record.name}", record.channel_id, hosted.epoch, host_id)
        if hosted.moving is not None:
            raise refusals.move_conflict(hosted.record.name)
        if hosted.replication is not None:
            hosted.replication.check_movable()
        if hosted.recording is not None:
            hosted.recording.check_movable()
        self._slots.check(hosted.record)

    def over(self, hosted: HostedChannel) -> None:
        """Note that the feed of a move has ended."""
        self._slots.give_back(hosted.record)

    def start(self, work: Coroutine[Any, Any, None], name: str) -> None:
        """Do `work` in the background. It continues if the stream of the move ends."""
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def aclose(self) -> None:
        """Stop all work."""
        for task in [*self._tasks]:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.moved.close()


class OutgoingMove:
    """One move away. The stream that feeds the destination calls a method for each step, `feed_ended` last."""

    def __init__(
        self, moves: OutgoingMoves, hosted: HostedChannel, moving: MoveUnderWay, host_id: bytes, target: str
    ) -> None:
        self._moves = moves
        self._hosted = hosted
        self._moving = moving
        self._host_id = host_id
        self._target = target
        self._timer: asyncio.TimerHandle | None = None
        self._is_released = False

    @property
    def _is_under_way(self) -> bool:
        """Whether this host still has the channel as this move knows it.

        The channel may have moved away and back since.
        """
        return self._hosted.moving is self._moving and self._moves.store.serves(self._hosted)

    @property
    def is_held(self) -> bool:
        """Whether the channel can no longer change."""
        return self._moving.is_held

    @property
    def is_committed(self) -> bool:
        """Whether this host knows that the destination is the owner."""
        return self._moving.redirect_error is not None

    @property
    def permit(self) -> bytes:
        """The permit with which the destination may become the owner. It is for the present epoch."""
        hosted = self._hosted
        return self._moves.allowed.permit(hosted.record.channel_id, hosted.epoch, self._host_id)

    def step(self, request: pb.FeedRequest) -> bool:
        """Take the steps that the destination asks for. Returns whether it asks for `released`."""
        if request.hold:
            self.hold()
        if request.committed_epoch:
            self.committed(request.committed_epoch)
        if request.released:
            self.released()
        return request.released

    def hold(self) -> None:
        """Let all changes wait. Idempotent.

        Ends the move after HELD_SECONDS_MAX if the destination has not committed it.
        """
        if self._moving.is_held or not self._is_under_way:
            return
        self._moving.hold()
        self._timer = asyncio.get_running_loop().call_later(HELD_SECONDS_MAX, self._held_too_long)

    def _held_too_long(self) -> None:
        """End the move unless it is committed."""
        if self._is_under_way and not self.is_committed:
            self._end_soon()

    def committed(self, epoch: int) -> None:
        """Send all callers to the destination, because it is the owner now. Idempotent."""
        if self.is_committed or not self._is_under_way:
            return
        record = self._hosted.record
        error = refusals.moved_to(record.name, self._host_id, self._target, epoch, record.spec_version)
        self._moving.redirect(error)
        self._moves.moved.note(record.name)
        self._moves.store.scheduler.begin(self._hosted.ending(error))

    def released(self) -> None:
        """Drop the items of this host, if the directory no longer needs them. Idempotent.

        The destination has asked for this. This host asks the directory first: if the lease of the destination has
        ended meanwhile, this host may be the owner again.
        """
        if self.is_committed and not self._is_released and self._is_under_way:
            self._is_released = True
            self._moves.start(self._keep_items(), "release")

    def feed_ended(self) -> None:
        """Note that the stream to the destination has ended. Unless the move is over, learn its outcome."""
        self._moves.over(self._hosted)
        if self._timer is not None:
            self._timer.cancel()
        if not self._is_under_way or self._is_released:
            return
        if self.is_committed:
            self._moves.start(self._keep_items(), "fallback")
        elif self._moving.is_held:
            self._end_soon()
        else:
            self._hosted.end_move()

    def _end_soon(self) -> None:
        self._moves.start(self._end(), "end of a move")

    async def _end(self) -> None:
        """Take a new epoch, so that the destination can no longer commit the move. Or learn that it has committed."""
        directory, record, request_id = self._moves.directory, self._hosted.record, secrets.token_bytes(16)
        while self._is_under_way and not self.is_committed:
            try:
                present = await directory.commit(record.channel_id, record.epoch, request_id)
                if not self._is_under_way:
                    return
                self._moves.store.adopt(present)
                logger.info(
                    "a move has failed; the channel stays", extra={"event": "move_ended", "channel": record.name}
                )
                return
            except StaleBinding:
                await self._learn_owner()
            except ChannelNotFound:
                self._moves.store.forget(record.channel_id, refusals.deleted(record.name))
            except StampedeError as error:
                extra = {"event": "move_undecided", "channel": record.name, "why": str(error)}
                logger.info("cannot ask the directory for the outcome of a move; the host tries again", extra=extra)
                await asyncio.sleep(RETRY_SECONDS)

    async def _learn_owner(self) -> None:
        """Learn that another owner was committed, or that this host has another epoch."""
        try:
            present = await self._moves.directory.resolve(self._hosted.record.channel_id)
        except StampedeError:
            await asyncio.sleep(RETRY_SECONDS)
            return
        if not self._is_under_way:
            return
        if present.host_id == self._moves.identity.host_id:
            self._moves.store.adopt(present)
            return
        self.committed(present.epoch)
        await self._keep_items()

    async def _keep_items(self) -> None:
        """Keep the items while this host may become the owner again."""
        while self._is_under_way:
            try:
                if await self._is_no_longer_needed():
                    return
            except StampedeError as error:
                extra = {"event": "move_undecided", "channel": self._hosted.record.name, "why": str(error)}
                logger.info("cannot ask the directory for the outcome of a move; the host tries again", extra=extra)
            await asyncio.sleep(FALLBACK_SECONDS)

    async def _is_no_longer_needed(self) -> bool:
        """Ask the directory, and act on the answer. True: this host has dropped the items, or is a replica now."""
        channel_id, name = self._hosted.record.channel_id, self._hosted.record.name
        error: StampedeError = self._moving.redirect_error or refusals.moved(name, self._host_id)
        try:
            directory = self._moves.directory
            kept = (
                FormerOwnerRole.NO if await directory.is_released(channel_id) else await directory.kept_here(channel_id)
            )
            if kept is not FormerOwnerRole.NO:
                return await self._has_demoted(kept)
        except ChannelNotFound:
            error = refusals.deleted(name)
        if self._is_under_way:
            self._moves.store.forget(channel_id, error)
        return True

    async def _has_demoted(self, kept: FormerOwnerRole) -> bool:
        """Serve the channel again if this host owns it again, or keep a replica of it. Returns whether this host keeps
        a replica, or no longer has the channel as this move knows it.
        """
        present = await self._moves.directory.resolve(self._hosted.record.channel_id)
        if not self._is_under_way:
            return True
        if present.host_id == self._moves.identity.host_id:
            self._moves.store.adopt(present)
            return False
        if kept is FormerOwnerRole.REPLICA:
            self._moves.keeper.demote(self._hosted, present)
        return kept is FormerOwnerRole.REPLICA
