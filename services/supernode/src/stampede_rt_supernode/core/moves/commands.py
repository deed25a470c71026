"""Commands about moves, and their results (paper, section 4.1). Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_supernode.core.commands import Operation, Success
from stampede_rt_supernode.core.records import ChannelRecord, QueueRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class CommitMove(Operation):
    """Make a host the owner of a channel, which keeps its incarnation. `epoch`: the epoch that the move began with.

    `to_registered_index`: the log position of that host's registration, as the host knows it; 0: the directory does not
    compare it. `permit`: the owner's permit for that host, see `move_permits`; only the owner itself needs none. The
    owner writes this command with its own id as `to_host_id` to abort a move to another host: the epoch rises, so the
    directory refuses the commit of that host.
    """

    channel_id: bytes
    epoch: int
    to_host_id: bytes
    to_boot_incarnation: int
    to_registered_index: int = 0
    permit: bytes = b""


@dataclass(frozen=True, kw_only=True, slots=True)
class MoveCommitted(Success):
    """The channel, with its new owner and epoch."""

    channel: ChannelRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class MoveToCommit:
    """One of the moves of `CommitMoves`. See `CommitMove`."""

    channel_id: bytes
    epoch: int
    permit: bytes = b""


@dataclass(frozen=True, kw_only=True, slots=True)
class CommitMoves(Operation):
    """Make a host the owner of several channels. Each move succeeds or fails by itself. See `CommitMove`."""

    to_host_id: bytes
    to_boot_incarnation: int
    to_registered_index: int = 0
    moves: tuple[MoveToCommit, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class MovesCommitted(Success):
    """The channels of which the host is the owner now. The other moves have failed."""

    channels: tuple[ChannelRecord, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class MoveToRelease:
    """One of the moves of `ReleaseMoves`. `epoch`: the channel's epoch since the move."""

    channel_id: bytes
    epoch: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ReleaseMoves(Operation):
    """Remove the fallbacks of channels, because the new owner `host_id` has all their items and needs no fallbacks."""

    host_id: bytes
    moves: tuple[MoveToRelease, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class MovesReleased(Success):
    """The channels without fallbacks. The others have another owner or epoch, or do not exist."""

    channel_ids: tuple[bytes, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class CommitQueueMove(Operation):
    """Make a host the owner of a queue or mailbox, which keeps its incarnation. See `CommitMove`."""

    queue_id: bytes
    epoch: int
    to_host_id: bytes
    to_boot_incarnation: int
    to_registered_index: int = 0
    permit: bytes = b""


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueMoveCommitted(Success):
    """The queue, with its new owner and epoch."""

    queue: QueueRecord
