"""Rules about cluster ids: which id a call names, and when a part may change to another cluster. Pure.

An operator may restore a backup at one of a cluster's addresses. A caller that accepts any directory would then leave
its cluster for the backup. Therefore clients, hosts and front-ends stay with the first cluster that they met, and each
of their calls names this cluster. They change to another cluster in two cases. In the first case the other cluster says
that it replaces their cluster (`supernode init --restore --take-over`). In the second case both clusters keep their
data only in memory. Their own cluster then cannot come back.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from stampede_rt.errors import WrongCluster

METADATA_KEY = "stampede-cluster-id"
IN_MEMORY = "memory-"  # the beginning of the id of a cluster that keeps its data only in memory
_SHOWN_MAX = 64  # the characters of a caller's cluster id that an error shows


class ClusterSeen(NamedTuple):
    """A cluster as one of its servers describes it: its id, and the ids of the clusters that it replaces."""

    cluster_id: str
    former: tuple[str, ...] = ()


def cluster_metadata(cluster_id: str) -> tuple[tuple[str, str], ...]:
    """Return the metadata with which a call names its cluster; empty if `cluster_id` is empty."""
    return ((METADATA_KEY, cluster_id),) if cluster_id else ()


def named_cluster(metadata: Iterable[Any] | None) -> str:
    """Return the id of the cluster that a call names; empty if it names none."""
    return next((str(value) for key, value in metadata or () if key == METADATA_KEY), "")


def may_change_to(own: str, to: str, to_former: Iterable[str]) -> bool:
    """Whether a client or service of cluster `own` may change to cluster `to`, which replaces the clusters `to_former`.

    `own` is empty if the client or service has met no cluster yet.
    """
    return (
        not own or not to or own == to or own in to_former or (own.startswith(IN_MEMORY) and to.startswith(IN_MEMORY))
    )


def cluster_among(own: str, seen: Iterable[ClusterSeen]) -> str:
    """Return the id of the cluster to which the caller belongs after the answers `seen`.

    It is `own` if that cluster answers; otherwise the first cluster to which the caller may change; otherwise `own`.
    """
    known = [one for one in seen if one.cluster_id]
    if own and any(one.cluster_id == own for one in known):
        return own
    return next((one.cluster_id for one in known if may_change_to(own, *one)), own)


def wrong_cluster(who: str, own: str, callers: str) -> WrongCluster:
    """Return the error with which a server of cluster `own` refuses a caller of cluster `callers`.

    `who` names the server, such as "this supernode".
    """
    return WrongCluster(
        f"{who} is of cluster {own}, and the caller of cluster {callers[:_SHOWN_MAX]}; the caller's cluster may still "
        "serve; if that cluster is permanently lost, start the caller again (if it is a host, first remove the file "
        "cluster-id from its data folder), or restore with `stampede supernode init --restore --take-over`",
        metadata={"cluster_id": own},
    )
