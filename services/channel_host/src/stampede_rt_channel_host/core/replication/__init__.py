"""The replicas of a channel, as its owner sees them (see `docs/replicas.md`). Pure."""

from stampede_rt_channel_host.core.replication.in_sync import (
    EARLY_LAG_NANOS_MAX,
    LAG_NANOS_MAX,
    KnownReplica,
    ReplicaChange,
    ReplicasInSync,
    ReplicaState,
)

__all__ = ["EARLY_LAG_NANOS_MAX", "LAG_NANOS_MAX", "KnownReplica", "ReplicaChange", "ReplicaState", "ReplicasInSync"]
