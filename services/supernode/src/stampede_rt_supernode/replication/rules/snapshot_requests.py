"""Requests for a snapshot now. The log also takes snapshots by itself: when it is long, and at regular times."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from stampede_rt_supernode.replication.interface import LogUnavailable
from stampede_rt_supernode.replication.rules.raft_node import NodeState
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.store import StoredSnapshot

SnapshotOutcome = StoredSnapshot | LogUnavailable


class SnapshotRequest(NamedTuple):
    """A caller's request for a snapshot. `done` is called once, on the tick thread."""

    done: Callable[[SnapshotOutcome], None]


class SnapshotRequests:
    """Requests snapshots of the node until one covers the position that was applied when the request came.

    Tick thread only.
    """

    def __init__(self, node: NodeState, log: RaftLog, finish: Callable[[Callable[[], None]], None]) -> None:
        self._node = node
        self._log = log
        self._finish_later = finish
        # (applied index at the request, request)
        self._waiting: list[tuple[int, SnapshotRequest]] = []

    @property
    def is_idle(self) -> bool:
        """Whether no request waits."""
        return not self._waiting

    def add(self, request: SnapshotRequest) -> None:
        """Accept a request."""
        self._waiting.append((self._node.last_applied, request))

    def advance(self) -> None:
        """Answer the requests whose positions the present snapshot covers.

        For the other requests, the node takes another snapshot.
        """
        snapshot = self._log.snapshot
        if snapshot is not None:
            covered = [one for since, one in self._waiting if since <= snapshot.last_log_index]
            self._waiting = [(since, one) for since, one in self._waiting if since > snapshot.last_log_index]
            for request in covered:
                self._finish(request, snapshot)
        if self._waiting and not self._node.keeper.is_taking:
            self._node.request_snapshot()

    def close(self) -> None:
        """Finish all requests with LogUnavailable."""
        for _, request in self._waiting:
            self._finish(request, LogUnavailable("this replica is closing"))
        self._waiting = []

    def _finish(self, request: SnapshotRequest, outcome: SnapshotOutcome) -> None:
        self._finish_later(lambda: request.done(outcome))
