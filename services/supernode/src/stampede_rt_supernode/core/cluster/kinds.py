"""The rows of the cluster as a whole in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.cluster.commands import BeginTenure, MarkTime, TenureBegun, TimeMarked
from stampede_rt_supernode.core.cluster.transitions import begin_tenure, mark_time
from stampede_rt_supernode.core.command_kinds import CommandKind

KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=BeginTenure,
        result=TenureBegun,
        subject=lambda one: str(one.tenure),
        apply=begin_tenure,
        needs_room=False,
    ),
    CommandKind(
        operation=MarkTime,
        result=TimeMarked,
        subject=lambda one: str(one.tenure),
        apply=mark_time,
        is_remembered=False,  # a repeated one does not follow the last mark any more
    ),
)
