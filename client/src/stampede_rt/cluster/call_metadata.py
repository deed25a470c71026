"""The metadata of every call of one connection."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.cluster.tracing import trace_metadata
from stampede_rt.security.credentials import call_metadata


class CallMetadata:
    """The metadata of the calls of one connection: its present secret, the id of its cluster when the id is known,
    and the trace to which a call belongs.

    All endpoints of the connection share this object.
    """

    def __init__(self, present_secret: Callable[[], str | None]) -> None:
        self._present_secret = present_secret
        self._cluster_metadata: tuple[tuple[str, str], ...] = ()
        self._cluster_id = ""

    def __call__(self) -> tuple[tuple[str, str], ...]:
        """Return the metadata of a call that begins now."""
        return call_metadata(self._present_secret()) + self._cluster_metadata + trace_metadata()

    @property
    def cluster_id(self) -> str:
        """The id of the cluster that calls name; empty as long as it is unknown."""
        return self._cluster_id

    @cluster_id.setter
    def cluster_id(self, cluster_id: str) -> None:
        self._cluster_id = cluster_id
        self._cluster_metadata = cluster_metadata(cluster_id)
