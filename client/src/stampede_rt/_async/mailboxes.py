"""The mailboxes of other peers, as an operator sees them."""

from __future__ import annotations

from stampede_rt._async.files import Files
from stampede_rt._async.peer_locator import PeerLocator
from stampede_rt._async.queue import pending_at, stats_at
from stampede_rt.values.policy import parse_name
from stampede_rt.values.queueing import PendingMessage, QueueStats


class Mailboxes(Files):
    """Counters and leases of mailboxes, by the names of their peers."""

    async def mailbox_stats(self, peer: str) -> QueueStats:
        """Return the counters of a peer's mailbox at one moment. Raises PeerNotFound, Unavailable."""
        return await stats_at(self._session, PeerLocator(self._session, parse_name(peer, "peer")))

    async def mailbox_pending(self, peer: str, limit: int = 1000) -> list[PendingMessage]:
        """List the messages that a peer has taken from its mailbox and not yet settled (see `Queue.pending`).

        Raises PeerNotFound, Unavailable, InvalidArgument.
        """
        return await pending_at(self._session, PeerLocator(self._session, parse_name(peer, "peer")), limit)
