"""Commands of a leader about the cluster as a whole, and their results. Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class BeginTenure(Operation):
    """A new leader takes over the leases. The very first leader also founds the cluster.

    `new_cluster_id`, `new_lease_ttl_nanos`: the id of a new cluster, and the duration of its leases. `founded_anew`:
    the cluster was restored, so the id replaces the id of the former cluster. `takes_over`: whether this cluster serves
    the hosts and other callers of that former cluster. `new_feature_level`: the first level of a new cluster.
    """

    tenure: int
    supernode_id: str
    new_cluster_id: str
    new_lease_ttl_nanos: int
    founded_anew: bool = False
    takes_over: bool = False
    new_feature_level: int = 1
    new_join_key: bytes = field(default=b"", repr=False)
    new_token_key: bytes = field(default=b"", repr=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class MarkTime(Operation):
    """The leader of `tenure` notes that MARK_NANOS have passed since the last mark; see `kept_answers`.

    `after_index`: the log position of the last mark that the leader knows.
    """

    tenure: int
    after_index: int


@dataclass(frozen=True, kw_only=True, slots=True)
class RaiseFeatureLevel(Operation):
    """The leader of `tenure` raises the feature level, because all members know this level; see `feature_levels`."""

    feature_level: int
    tenure: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class TenureBegun(Success):
    """The present tenure, and the cluster's id."""

    tenure: int
    cluster_id: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeMarked(Success):
    """`marked`: whether the command added a mark. A repeated command, or a command of a former leader, adds none."""

    marked: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class FeatureLevelRaised(Success):
    """The present feature level."""

    feature_level: int
