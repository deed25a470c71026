"""The cluster of this supernode, and the callers that it serves."""

from __future__ import annotations

from stampede_rt.cluster.cluster_ids import may_go_over, wrong_cluster
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_runtime.cluster_ids import cluster_id_of
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.replica import DirectoryReplica


class OwnCluster:
    """The data folder tells the id, unless the cluster was founded with a list. Then the directory tells it."""

    def __init__(self, replica: DirectoryReplica) -> None:
        self._replica = replica
        self._known = ""

    def learn(self, log_cluster_id: str) -> None:
        """Take the cluster's id among its members, at the start, before any call is served."""
        self._known = cluster_id_of(log_cluster_id)

    def id(self) -> str:
        """The id of this cluster, or the one that it will have once its founder leads; empty: unknown yet."""
        return self._known or self._replica.read(_id_of)

    def judge(self, callers: str) -> StampedeError | None:
        """The error for a caller of the cluster `callers`; None: the supernode serves it.

        Serves no caller while the state is still empty, or that of the former cluster of a restored one, because reads
        and updates would concern that state.
        """
        own, held = self.id(), self._replica.read(_id_of)
        if not own or held != own:
            return Unavailable(f"cluster {own or 'here'} is just beginning; try again in a moment", reason="NO_QUORUM")
        if may_go_over(callers, own, self._replica.read(_former_of)):
            return None
        return wrong_cluster("this supernode", own, callers)


def _id_of(directory: Directory) -> str:
    return directory.cluster_id


def _former_of(directory: Directory) -> tuple[str, ...]:
    return directory.former_cluster_ids
