# Generated from ../_async by tools/generate.py; do not edit.
"""Finds the mailbox of a peer for its senders."""

from __future__ import annotations

from stampede_rt._sync.queue_locator import QueueLocator, QueueState, learn_queue
from stampede_rt._sync.session import Session, left_s
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import PeerNotFound, QueueNotFound, StampedeError, Unavailable
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.values.queueing import QueueInfo, QueuePolicy

# The description of a mailbox that the client has not looked for yet.
UNKNOWN = QueueInfo(
    queue_id=b"", name="", host_id=b"", host="", host_alive=False, epoch=0, incarnation=0, policy=QueuePolicy(),
    spec_version=0,
)  # fmt: skip


class PeerLocator(QueueLocator):
    """Finds a mailbox by the peer's name. A peer that registers again may have another mailbox."""

    def __init__(self, session: Session, name: str) -> None:
        state = QueueState("peer", name, UNKNOWN, QueuePolicy(), create=False)
        super().__init__(session, state)

    def find(self, deadline_s: float) -> Binding:
        """Return the binding of the peer's mailbox, from the cache or the cluster. Raises PeerNotFound, Unavailable."""
        if self._session.cache.owner(self._state.info.queue_id) is None:
            self._resolve(deadline_s)
        return super().find(deadline_s)

    def _resolve(self, deadline_s: float) -> None:
        name = self._state.name
        request = queue_directory_pb.ResolveQueueRequest(peer_name=name)
        try:
            response = self._session.supernodes.call("ResolveQueue", request, left_s(deadline_s))
        except QueueNotFound as error:
            raise peer_not_found(name) from error
        if not response.host.alive:
            raise Unavailable(
                f"the mailbox of peer {name!r} was lost with its host; a live peer soon gets another mailbox: try again"
            )
        self._state.info = learn_queue(self._session, response.queue, response.host)

    def explain(self, error: StampedeError) -> None:
        """Add the name of the peer to the error.

        If the mailbox does not exist, mark the error as retryable, because the peer may have a new mailbox.
        """
        super().explain(error)
        if isinstance(error, QueueNotFound):
            error.retryable = True


def peer_not_found(name: str) -> PeerNotFound:
    """Return the error for a name that no live peer has."""
    return PeerNotFound(f"no live peer is named {name!r}; peers() lists the live ones", metadata={"peer": name})
