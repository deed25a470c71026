"""Keeps a table of the leases of peers. The table follows the directory's changes of peers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from stampede_rt_supernode.core.change_ring import ChangePage
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.lease import LeaseTable
from stampede_rt_supernode.core.records import ChangeKind, DirectoryChange, PeerRecord
from stampede_rt_supernode.replica import DirectoryReplica

PEERS_PER_TURN = 1024  # the most peers at which one turn of the event loop looks


class FollowedPeers:
    """Brings a table of leases up to date with the peers of the directory. Use it on one event loop."""

    def __init__(
        self, leases: LeaseTable, replica: DirectoryReplica, let_others_run: Callable[[], Awaitable[None]]
    ) -> None:
        """`let_others_run` lets other tasks of the event loop run."""
        self._leases = leases
        self._replica = replica
        self._let_others_run = let_others_run
        # How far the table has followed the directory: `replica.restored` at that time, and the position in the ring of
        # peers. None if it has followed nothing in this tenure.
        self._followed: tuple[int, int] | None = None

    def begin(self) -> None:
        """Begin a tenure with an empty table: the next call of `follow` goes through all peers."""
        self._followed = None

    async def follow(self, now: int) -> None:
        """Apply the changes of peers to the table of leases, some in each turn of the event loop.

        If the ring has dropped some of these changes, go through all peers.
        """
        while True:  # ends with the last change
            page = self._replica.read(self._changed_peers)
            if page is None:
                await self._follow_all(now)
            elif page.changes:
                for change in page.changes:
                    self._note(change, now)
                self._followed = (self._followed or (-1, 0))[0], page.position
            else:
                return
            await self._let_others_run()

    def _changed_peers(self, directory: Directory) -> ChangePage | None:
        """The next changes; None if the ring has dropped them, or the whole state was replaced."""
        restored, position = self._followed or (-1, 0)
        ring = directory.tables.peers.changes
        return ring.read(position, PEERS_PER_TURN) if restored == self._replica.restored else None

    def _note(self, change: DirectoryChange, now: int) -> None:
        peer = change.subject
        assert isinstance(peer, PeerRecord), "the ring of peers holds changes of peers only"
        if change.kind is ChangeKind.REMOVED or not peer.alive:
            self._leases.note_gone(peer.peer_id, change.index)
        else:
            self._leases.note(peer, now)

    async def _follow_all(self, now: int) -> None:
        peers, index, followed = self._replica.read(self._all_peers)
        live: list[PeerRecord] = []
        for start in range(0, len(peers), PEERS_PER_TURN):
            live += [one for one in peers[start : start + PEERS_PER_TURN] if one.alive]
            await self._let_others_run()
        for _ in self._leases.following(live, index, now):
            await self._let_others_run()
        self._followed = followed

    def _all_peers(self, directory: Directory) -> tuple[tuple[PeerRecord, ...], int, tuple[int, int]]:
        peers = directory.tables.peers
        state = self._replica.restored, peers.changes.end_position
        return tuple(peers.by_id.values()), directory.applied_index, state
