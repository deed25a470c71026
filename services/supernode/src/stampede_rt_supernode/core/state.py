"""The replicated state on which the supernodes agree. Pure. Only commands of the log change it."""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.access.table import AccessTable
from stampede_rt_supernode.core.cluster.feature_levels import FIRST_LEVEL
from stampede_rt_supernode.core.kept_answers import KeptAnswer, KeptAnswers
from stampede_rt_supernode.core.records import (
    ChannelRecord,
    GroupRecord,
    HostRecord,
    PeerRecord,
    QueueRecord,
    ReplicaRecord,
)
from stampede_rt_supernode.core.tables import Tables

DIGEST_BYTES = 16


class DirectoryState:
    """The tables, and the facts about the cluster as a whole.

    `tenure` never falls. The first tenure sets the cluster's id and the TTL of its leases, which is 0 until then. In a
    restored cluster, the first tenure after the restore sets another id. No later tenure changes the TTL, because hosts
    and all leaders must use the same. The feature level never falls.
    """

    def __init__(
        self,
        *,
        index: int = 0,
        tenure: int = 0,
        cluster_id: str = "",
        lease_ttl_nanos: int = 0,
        hosts: Iterable[HostRecord] = (),
        channels: Iterable[ChannelRecord] = (),
        groups: Iterable[tuple[GroupRecord, tuple[bytes, ...]]] = (),
        replicas: Iterable[ReplicaRecord] = (),
        queues: Iterable[QueueRecord] = (),
        peers: Iterable[PeerRecord] = (),
        answers: Iterable[KeptAnswer] = (),
        time_marks: Iterable[int] = (),
        former_cluster_ids: Iterable[str] = (),
        join_key: bytes = b"",
        digest: bytes = b"",
        feature_level: int = FIRST_LEVEL,
        access: AccessTable | None = None,
    ) -> None:
        self.tenure = tenure
        self.feature_level = max(feature_level, FIRST_LEVEL)
        self.cluster_id = cluster_id
        self.lease_ttl_nanos = lease_ttl_nanos
        # The digest of all results so far. Replicas with different digests have different states. It is empty if it is
        # unknown, as after a snapshot without a digest.
        self.digest = digest or (b"" if index else bytes(DIGEST_BYTES))
        # The ids of the clusters that this cluster has replaced.
        self.former_cluster_ids = tuple(former_cluster_ids)
        # The key that signs join tokens. No caller ever gets it.
        self.join_key = join_key
        self.access = access or AccessTable()
        self.tables = Tables(hosts, channels, groups=groups, replicas=replicas, queues=queues, peers=peers, index=index)
        self.kept_answers = KeptAnswers(answers, time_marks)

    @property
    def applied_index(self) -> int:
        """The last log position applied."""
        return self.tables.index

    def check_founded(self) -> None:
        """Raises Unavailable with reason NO_QUORUM before the first tenure."""
        if not self.tenure:
            text = "the cluster has just been founded, and no leader grants leases yet; try again in a moment"
            raise Unavailable(text, reason="NO_QUORUM")
