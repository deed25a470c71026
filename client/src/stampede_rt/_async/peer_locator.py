"""Where the mailbox of a peer is, for those who send to it."""

from __future__ import annotations

from stampede_rt._async.queue_locator import QueueLocator, QueueState, learn_queue
from stampede_rt._async.session import Session, left_s
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import PeerNotFound, QueueNotFound, StampedeError, Unavailable
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.values.queueing import QueueInfo, QueuePolicy

UNKNOWN = QueueInfo(
    queue_id=b"", name="", host_id=b"", host="", host_alive=False, epoch=0, incarnation=0, policy=QueuePolicy(),
    spec_version=0,
)  # fmt: skip


class PeerLocator(QueueLocator):
    """Found by the peer's name; a peer that comes back may have another mailbox."""

    def __init__(self, session: Session, name: str) -> None:
        state = QueueState("peer", name, UNKNOWN, QueuePolicy(), create=False)
        super().__init__(session, state)

    async def find(self, deadline_s: float) -> Binding:
        """The cached place, or one found anew. Raises PeerNotFound."""
        if self._session.cache.owner(self._state.info.queue_id) is None:
            await self._resolve(deadline_s)
        return await super().find(deadline_s)

    async def _resolve(self, deadline_s: float) -> None:
        name = self._state.name
        request = queue_directory_pb.ResolveQueueRequest(peer_name=name)
        try:
            response = await self._session.supernodes.call("ResolveQueue", request, left_s(deadline_s))
        except QueueNotFound as error:
            raise peer_not_found(name) from error
        if not response.host.alive:
            raise Unavailable(f"the host of the mailbox of peer {name!r} is lost; the peer gets another soon")
        self._state.info = learn_queue(self._session, response.queue, response.host)

    def explain(self, error: StampedeError) -> None:
        """Name the peer. A mailbox that is gone may have been replaced: that is found out by looking for the peer."""
        super().explain(error)
        if isinstance(error, QueueNotFound):
            error.retryable = True


def peer_not_found(name: str) -> PeerNotFound:
    """No live participant has that name, and so there is no mailbox."""
    return PeerNotFound(f"no live peer is named {name!r}; peers() lists those there are", metadata={"peer": name})
