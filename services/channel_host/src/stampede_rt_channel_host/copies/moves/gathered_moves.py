"""Gathers the calls about moves that one host makes at the same time into few calls to the directory.

A host that is drained moves up to 112 channels at the same time. One entry of the log then commits several moves, so
that the disks of the supernodes write once for all of them.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from typing import NamedTuple

from stampede_rt.errors import ChannelNotFound, StaleBinding, StampedeError
from stampede_rt_channel_host.cluster.gathered_calls import GatheredCalls
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.core.records import RecordedChannel

OwnedChannel = tuple[RecordedChannel, FeedSource]  # a channel, and its owner

MOVES_MAX = 32  # the most moves in one call
CHANGE_SECONDS = 0.01  # the least time between two entries; puts of the channels wait meanwhile
OWNER_SECONDS = 0.01  # the least time between two lookups of owners; moves have not begun yet
DROP_SECONDS = 0.1  # the least time between two lookups by a former owner; it keeps its items meanwhile


class MoveCommit(NamedTuple):
    """The commit of one move, see `GatheredMoves.commit`."""

    channel_id: bytes
    epoch: int
    request_id: bytes
    permit: bytes


class FallbackRelease(NamedTuple):
    """A channel whose new owner needs no fallback. `epoch` is the channel's epoch since the move."""

    channel_id: bytes
    epoch: int


class GatheredMoves(ABC):
    """Gathers the calls of one host. A subclass makes the calls: `..._one` and `..._all` raise the directory's
    errors.
    """

    def __init__(self) -> None:
        self._owners = GatheredCalls(self._owner_of_each, MOVES_MAX, OWNER_SECONDS)
        self._commits = GatheredCalls(self._commit_each, MOVES_MAX, CHANGE_SECONDS)
        self._releases = GatheredCalls(self._release_each, MOVES_MAX, CHANGE_SECONDS)
        self._release_checks = GatheredCalls(self._released_each, MOVES_MAX, DROP_SECONDS)

    async def owner_of(self, channel_id: bytes) -> OwnedChannel:
        """The channel's present record, and its owner. The owner's `target` is empty if it is not alive. Raises
        ChannelNotFound.
        """
        return await self._owners.ask(channel_id)

    async def commit(self, channel_id: bytes, epoch: int, request_id: bytes, permit: bytes = b"") -> RecordedChannel:
        """Make this host the owner, if the channel's epoch is still `epoch`. Safe to repeat. Raises StaleBinding.

        `permit` is the present owner's permit; empty if this host is the owner.
        """
        move = MoveCommit(channel_id, epoch, request_id, permit)
        return await (self._commits.ask(move) if permit else self.commit_one(move))

    async def remove_fallback(self, channel_id: bytes, epoch: int) -> None:
        """Remove the fallback of this host, unless it is a replica. Idempotent. Raises StaleBinding."""
        await self._releases.ask(FallbackRelease(channel_id, epoch))

    async def is_released(self, channel_id: bytes) -> bool:
        """Whether the directory no longer names this host, the former owner, as fallback or replica of a channel.

        If the directory still names this host, `kept_here` returns the role.
        """
        return await self._release_checks.ask(channel_id)

    @abstractmethod
    async def owner_of_one(self, channel_id: bytes) -> OwnedChannel:
        """One channel and its owner."""

    @abstractmethod
    async def owners_of(self, channel_ids: Sequence[bytes]) -> Sequence[OwnedChannel]:
        """The channels that exist, and their owners."""

    @abstractmethod
    async def commit_one(self, move: MoveCommit) -> RecordedChannel:
        """Commit one move."""

    @abstractmethod
    async def commit_all(self, moves: Sequence[MoveCommit]) -> Sequence[RecordedChannel]:
        """Commit moves. Returns the channels of which this host is the owner now."""

    @abstractmethod
    async def release_all(self, moves: Sequence[FallbackRelease]) -> Collection[bytes]:
        """Remove the fallbacks of channels. Returns the channels that have no fallback now."""

    @abstractmethod
    async def released_of(self, channel_ids: Sequence[bytes]) -> Collection[bytes]:
        """The channels for which `is_released` is true."""

    async def _owner_of_each(self, channel_ids: Sequence[bytes]) -> list[OwnedChannel | StampedeError]:
        if len(channel_ids) == 1:
            return [await self.owner_of_one(channel_ids[0])]
        found = {one[0].channel_id: one for one in await self.owners_of(channel_ids)}
        return [found.get(one) or _unknown(one) for one in channel_ids]

    async def _commit_each(self, moves: Sequence[MoveCommit]) -> list[RecordedChannel | StampedeError]:
        if len(moves) == 1:
            return [await self.commit_one(moves[0])]
        committed = {one.channel_id: one for one in await self.commit_all(moves)}
        others = [one for one in moves if one.channel_id not in committed]
        outcomes = dict(zip(others, await asyncio.gather(*map(self._outcome, others)), strict=True))
        return [committed.get(one.channel_id) or outcomes[one] for one in moves]

    async def _outcome(self, move: MoveCommit) -> RecordedChannel | StampedeError:
        """Commit a move alone, to learn why the common entry has not committed it."""
        try:
            return await self.commit_one(move)
        except StampedeError as error:
            return error

    async def _release_each(self, moves: Sequence[FallbackRelease]) -> list[StampedeError | None]:
        released = await self.release_all(moves)
        return [None if one.channel_id in released else _stale_release(one) for one in moves]

    async def _released_each(self, channel_ids: Sequence[bytes]) -> list[bool | StampedeError]:
        released = await self.released_of(channel_ids)
        return [one in released for one in channel_ids]


def _unknown(channel_id: bytes) -> StampedeError:
    return ChannelNotFound(f"no channel has the id {channel_id.hex()}", metadata={"channel_id": channel_id.hex()})


def _stale_release(move: FallbackRelease) -> StampedeError:
    return StaleBinding(
        f"channel {move.channel_id.hex()} has another owner or epoch than {move.epoch} since its move; resolve it "
        "again",
        reason="WRONG_EPOCH",
        metadata={"channel_id": move.channel_id.hex()},
    )
