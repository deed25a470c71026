"""The rows of the cluster as a whole in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.cluster.commands import (
    BeginTenure,
    FeatureLevelRaised,
    MarkTime,
    RaiseFeatureLevel,
    TenureBegun,
    TimeMarked,
)
from stampede_rt_supernode.core.cluster.transitions import begin_tenure, mark_time, raise_feature_level
from stampede_rt_supernode.core.command_kinds import CommandKind

KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=BeginTenure,
        result=TenureBegun,
        feature_level=1,
        subject=lambda one: str(one.tenure),
        apply=begin_tenure,
        needs_room=False,
    ),
    CommandKind(
        operation=MarkTime,
        result=TimeMarked,
        feature_level=1,
        subject=lambda one: str(one.tenure),
        apply=mark_time,
        is_remembered=False,  # a repeated mark does not follow the last mark, so it does nothing
    ),
    CommandKind(
        operation=RaiseFeatureLevel,
        result=FeatureLevelRaised,
        feature_level=1,
        subject=lambda one: str(one.feature_level),
        apply=raise_feature_level,
        needs_room=False,
    ),
)
