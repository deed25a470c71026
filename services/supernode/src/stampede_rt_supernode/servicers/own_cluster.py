"""Which cluster this supernode is of, and whose callers it serves."""

from __future__ import annotations

from stampede_rt.cluster.cluster_ids import may_go_over, wrong_cluster
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_runtime.cluster_ids import cluster_id_of
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.replica import DirectoryReplica


class OwnCluster:
    """The id is known from the data folder, unless the cluster was founded by a list: then the directory says it."""

    def __init__(self, replica: DirectoryReplica) -> None:
        self._replica = replica
        self._known = ""

    def learn(self, log_cluster_id: str) -> None:
        """The cluster's id among its members: found at the start, before anybody is served."""
        self._known = cluster_id_of(log_cluster_id)

    def id(self) -> str:
        """Which cluster this is, or is about to be, once its founder has begun to lead; empty: not known yet."""
        return self._known or self._replica.read(_id_of)

    def judge(self, callers: str) -> StampedeError | None:
        """Why a caller of that cluster is not served; None: it is.

        While the state here is still that of another cluster, of which this one was restored, or of none, nobody is:
        what is read or done then might be another cluster's.
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
