"""The ids of clusters: which one a call names, and when a part may change to another one. Pure.

Somebody may restore a backup at one of a cluster's addresses. A caller that followed any directory would then leave its
cluster for the backup. So clients, hosts and front-ends stay with the first cluster that they met, and each of their
calls names it. They change in two cases. The other cluster says that it replaces theirs (`supernode init --restore
--take-over`). Or theirs was kept in memory alone, and so is the other one: theirs cannot come back.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from stampede_rt.errors import WrongCluster

METADATA_KEY = "stampede-cluster-id"
IN_MEMORY = "memory-"
_SHOWN_MAX = 64


class ClusterSeen(NamedTuple):
    """A server's word about its cluster: its id, and the ids of the clusters that it replaces."""

    cluster_id: str
    former: tuple[str, ...] = ()


def cluster_metadata(cluster_id: str) -> tuple[tuple[str, str], ...]:
    """The metadata of a call that names the cluster; none while the caller knows no cluster."""
    return ((METADATA_KEY, cluster_id),) if cluster_id else ()


def told_cluster(metadata: Iterable[Any] | None) -> str:
    """The cluster that a call names; empty if it names none."""
    return next((str(value) for key, value in metadata or () if key == METADATA_KEY), "")


def may_go_over(own: str, to: str, to_former: Iterable[str]) -> bool:
    """Whether a part of cluster `own` (empty: of none yet) may change to `to`, which replaces `to_former`."""
    return (
        not own or not to or own == to or own in to_former or (own.startswith(IN_MEMORY) and to.startswith(IN_MEMORY))
    )


def cluster_among(own: str, seen: Iterable[ClusterSeen]) -> str:
    """The id of the caller's cluster, once several have answered: its own if that one answers, else its successor's."""
    known = [one for one in seen if one.cluster_id]
    if own and any(one.cluster_id == own for one in known):
        return own
    return next((one.cluster_id for one in known if may_go_over(own, *one)), own)


def wrong_cluster(who: str, own: str, callers: str) -> WrongCluster:
    """The error of `who`, such as "this supernode", of cluster `own`, for a caller of another cluster."""
    return WrongCluster(
        f"{who} is of cluster {own}, and the caller of cluster {callers[:_SHOWN_MAX]}, which may still serve; if that "
        "one is gone for good, start a client or front-end again; stop a host, remove the file cluster-id from its "
        "data folder, and start it again (or restore with `stampede supernode init --restore --take-over`)",
        metadata={"cluster_id": own},
    )
