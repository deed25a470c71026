"""The rows of moves in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.cluster.feature_levels import MOVES_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind, on_tables
from stampede_rt_supernode.core.moves.commands import (
    CommitMove,
    CommitMoves,
    CommitQueueMove,
    MoveCommitted,
    MovesCommitted,
    MovesReleased,
    QueueMoveCommitted,
    ReleaseMoves,
)
from stampede_rt_supernode.core.moves.several import (
    check_commit_moves,
    check_release_moves,
    commit_moves,
    release_moves,
)
from stampede_rt_supernode.core.moves.transitions import (
    check_commit_move,
    check_commit_queue_move,
    commit_move,
    commit_queue_move,
)


def _channels(operation: CommitMoves | ReleaseMoves) -> str:
    return " ".join(one.channel_id.hex() for one in operation.moves)


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=CommitMove,
        result=MoveCommitted,
        feature_level=MOVES_LEVEL,
        subject=lambda one: f"{one.channel_id.hex()} {one.to_host_id.hex()}",
        check=check_commit_move,
        apply=on_tables(commit_move),
    ),
    CommandKind(
        operation=CommitQueueMove,
        result=QueueMoveCommitted,
        feature_level=MOVES_LEVEL,
        subject=lambda one: f"{one.queue_id.hex()} {one.to_host_id.hex()}",
        check=check_commit_queue_move,
        apply=on_tables(commit_queue_move),
    ),
    CommandKind(
        operation=CommitMoves,
        result=MovesCommitted,
        feature_level=MOVES_LEVEL,
        subject=_channels,
        check=check_commit_moves,
        apply=on_tables(commit_moves),
        is_remembered=False,  # the epochs make a repetition harmless
    ),
    CommandKind(
        operation=ReleaseMoves,
        result=MovesReleased,
        feature_level=MOVES_LEVEL,
        subject=_channels,
        check=check_release_moves,
        apply=on_tables(release_moves),
        is_remembered=False,  # the epochs make a repetition harmless
    ),
)
