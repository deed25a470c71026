"""Applies the commands of a leader: its tenure, its marks of time, and the feature level. Pure."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt_supernode.core.access.transitions import change_access
from stampede_rt_supernode.core.cluster.commands import (
    BeginTenure,
    FeatureLevelRaised,
    MarkTime,
    RaiseFeatureLevel,
    TenureBegun,
    TimeMarked,
)
from stampede_rt_supernode.core.cluster.feature_levels import LOADS_LEVEL
from stampede_rt_supernode.core.state import DirectoryState

FORMER_MAX = 16  # the most ids of former clusters that the state keeps
TOKENS_LEVEL = 2  # below this level no replica keeps a key for client tokens


def begin_tenure(state: DirectoryState, operation: BeginTenure, time_unix_nano: int) -> TenureBegun:
    """Begin a leader's tenure, and set missing parts of the state: the cluster's id, its keys, the TTL of its leases.

    `state.tenure` does not fall if the entry comes from a leader that was already replaced.
    """
    state.tenure = max(state.tenure, operation.tenure)
    if not state.cluster_id:
        state.feature_level = max(state.feature_level, operation.new_feature_level)
    if operation.founded_anew or not state.cluster_id:
        if state.cluster_id and operation.takes_over and state.cluster_id != operation.new_cluster_id:
            state.former_cluster_ids = (*state.former_cluster_ids, state.cluster_id)[-FORMER_MAX:]
        state.cluster_id, state.join_key = operation.new_cluster_id, operation.new_join_key
        if state.access.token_key:  # the key has signed tokens of the former cluster only
            change_access(state, replace(state.access, token_key=b""))
    state.join_key = state.join_key or operation.new_join_key
    if state.feature_level >= TOKENS_LEVEL and not state.access.token_key:
        change_access(state, replace(state.access, token_key=operation.new_token_key))
    state.lease_ttl_nanos = state.lease_ttl_nanos or operation.new_lease_ttl_nanos
    return TenureBegun(tenure=state.tenure, cluster_id=state.cluster_id)


def mark_time(state: DirectoryState, operation: MarkTime, time_unix_nano: int) -> TimeMarked:
    """Add a mark if the command comes from the present leader, and that leader knew the last mark."""
    marked = operation.tenure == state.tenure and operation.after_index == state.kept_answers.last_mark
    if marked:
        state.kept_answers.mark(state.applied_index)
    return TimeMarked(marked=marked)


def raise_feature_level(state: DirectoryState, operation: RaiseFeatureLevel, time_unix_nano: int) -> FeatureLevelRaised:
    """Raise the feature level. It never falls.

    From LOADS_LEVEL on, a late command of a former leader does nothing. Its successor may have admitted a member that
    does not know the level.
    """
    if state.feature_level < LOADS_LEVEL or operation.tenure == state.tenure:
        state.feature_level = max(state.feature_level, operation.feature_level)
    return FeatureLevelRaised(feature_level=state.feature_level)
