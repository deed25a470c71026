"""The id of this supernode's cluster, and the callers that this supernode serves."""

from __future__ import annotations

from stampede_rt.cluster.cluster_ids import may_change_to, wrong_cluster
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_runtime.cluster_ids import cluster_id_of
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.replica import DirectoryReplica


class OwnCluster:
    """Knows the id of this supernode's cluster, and which callers the supernode serves.

    The data folder has the id. If the supernodes founded the cluster together, from a list of members, the id is in the
    directory.
    """

    def __init__(self, replica: DirectoryReplica) -> None:
        self._replica = replica
        self._known = ""

    def learn(self, log_cluster_id: str) -> None:
        """Take the id of the cluster from the id that its replicated log has.

        Call this at the start, before the supernode serves calls.
        """
        self._known = cluster_id_of(log_cluster_id)

    def id(self) -> str:
        """The id that this cluster has, or will have as soon as its founder leads; empty if the id is not known yet."""
        return self._known or self._replica.read(_id_of)

    def judge(self, caller_cluster_id: str) -> StampedeError | None:
        """The error for a caller of that cluster; None if the supernode serves the caller.

        The supernode serves no caller while its state is still empty. In a restored cluster it serves no caller while
        it still has the state of the former cluster. Otherwise reads and updates would concern that state.
        """
        own, held = self.id(), self._replica.read(_id_of)
        if not own or held != own:
            return Unavailable(
                f"this supernode's cluster {own or '(its id is not known yet)'} has not had its first leader; "
                "try again in a moment",
                reason="NO_QUORUM",
            )
        if may_change_to(caller_cluster_id, own, self._replica.read(_former_of)):
            return None
        return wrong_cluster("this supernode", own, caller_cluster_id)


def _id_of(directory: Directory) -> str:
    return directory.cluster_id


def _former_of(directory: Directory) -> tuple[str, ...]:
    return directory.former_cluster_ids
