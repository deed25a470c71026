"""The rows of moves in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.cluster.feature_levels import MOVES_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind, on_tables
from stampede_rt_supernode.core.moves.commands import CommitMove, CommitQueueMove, MoveCommitted, QueueMoveCommitted
from stampede_rt_supernode.core.moves.transitions import (
    check_commit_move,
    check_commit_queue_move,
    commit_move,
    commit_queue_move,
)

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
)
