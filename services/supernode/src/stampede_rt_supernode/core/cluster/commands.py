"""Commands of a leader about the cluster as a whole, and their results. Pure, immutable values; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class BeginTenure(Operation):
    """A new leader takes over the leases; the first one of all founds the cluster: it gives it its id and its TTL.

    `founded_anew`: by restoring, so that the id is to replace that of the former cluster; `takes_over`: whose hosts may
    go over to this one. `new_feature_level`: where a new cluster begins.
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
    """Some time has passed since the last mark, says the leader of `tenure`, which was at `after_index`; see
    `answered`."""

    tenure: int
    after_index: int


@dataclass(frozen=True, kw_only=True, slots=True)
class RaiseFeatureLevel(Operation):
    """All members know this feature level, says a leader; see `feature_levels`."""

    feature_level: int


@dataclass(frozen=True, kw_only=True, slots=True)
class TenureBegun(Success):
    """The tenure now in force, and the cluster's id."""

    tenure: int
    cluster_id: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeMarked(Success):
    """Whether the mark counts; False: another leader's, or a repeated one."""

    marked: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class FeatureLevelRaised(Success):
    """The feature level now in force."""

    feature_level: int
