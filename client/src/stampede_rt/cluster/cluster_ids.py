"""Which cluster is which, how a call names its caller's, and who may go over from one to another. Pure.

A caller that followed whatever directory answers would leave its cluster for a backup that somebody restored at one of
its addresses. So clients, hosts and front-ends stay with the cluster that they have met first, and each of their calls
names it. They go over to one that says it takes the place of theirs (`supernode init --restore --take-over`), and from
one that was kept in memory alone to another one of this kind: the first one cannot come back.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from stampede_rt.errors import WrongCluster

METADATA_KEY = "stampede-cluster-id"
IN_MEMORY = "memory-"
_SHOWN_MAX = 64


class ClusterSeen(NamedTuple):
    """What a supernode or front-end says of its cluster: its id, and those of the clusters whose place it took."""

    cluster_id: str
    former: tuple[str, ...] = ()


def cluster_metadata(cluster_id: str) -> tuple[tuple[str, str], ...]:
    """What a call brings along; nothing while the caller knows no cluster."""
    return ((METADATA_KEY, cluster_id),) if cluster_id else ()


def told_cluster(metadata: Iterable[Any] | None) -> str:
    """The cluster that a call names; empty if it names none."""
    return next((str(value) for key, value in metadata or () if key == METADATA_KEY), "")


def may_go_over(own: str, to: str, to_former: Iterable[str]) -> bool:
    """Whether a part of cluster `own` (empty: of none yet) may be one of `to`, which took the place of `to_former`."""
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
    """`who`, such as "this supernode", is of cluster `own`, and refuses a caller of another one."""
    return WrongCluster(
        f"{who} is of cluster {own}, and the caller of cluster {callers[:_SHOWN_MAX]}, which may still serve; if that "
        "one is gone for good, start a client or front-end again; stop a host, remove the file cluster-id from its "
        "data folder, and start it again (or restore with `stampede supernode init --restore --take-over`)",
        metadata={"cluster_id": own},
    )
