"""The participants of the directory, by id and by name (paper, sections 3.5 and 4.2). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from sortedcontainers import SortedDict, SortedSet

from stampede_rt_supernode.core.change_ring import ChangeRing
from stampede_rt_supernode.core.records import ChangeKind, DirectoryChange, PeerRecord

DEAD_PEERS_MAX = 1000
# How peers are listed: those with names first, by name; then by id.
PeerKey = tuple[bool, str, bytes]


class PeerTable:
    """Peers whose lease has ended are kept for people to see, the last DEAD_PEERS_MAX of them. Changes are noted in a
    ring of their own: thousands of peers that come and go push no channel's changes out."""

    def __init__(self, peers: Iterable[PeerRecord], index: int) -> None:
        self.changes = ChangeRing(index)
        self.by_id: dict[bytes, PeerRecord] = {}
        self.ids: SortedDict[str, bytes] = SortedDict()  # by name; exactly the live ones that have one
        self.keys: SortedSet[PeerKey] = SortedSet()  # all, in the order of listings
        self._dead: dict[bytes, None] = {}  # ids, as their leases ended; those of one entry by id
        for peer in sorted(peers, key=lambda one: (one.ended_index, one.peer_id)):
            self._link(peer)

    def __len__(self) -> int:
        return len(self.by_id)

    @property
    def live_count(self) -> int:
        """How many live."""
        return len(self.by_id) - len(self._dead)

    def live(self) -> Iterator[PeerRecord]:
        """Those whose lease has not ended, in no order that means anything."""
        return (peer for peer in self.by_id.values() if peer.alive)

    def live_named(self, name: str) -> PeerRecord | None:
        """The live peer of that name, if there is one."""
        found = self.ids.get(name)
        return None if found is None else self.by_id[found]

    def put(self, peer: PeerRecord, index: int) -> None:
        """The peer of that id is now like this, as of log position `index`; no other live one has its name."""
        before = self.by_id.get(peer.peer_id)
        if before is not None:
            self._unlink(before)
        self._link(peer)
        self._note(index, ChangeKind.ADDED if before is None else ChangeKind.UPDATED, peer)
        if len(self._dead) > DEAD_PEERS_MAX:
            self.remove(self.by_id[next(iter(self._dead))], index)

    def remove(self, peer: PeerRecord, index: int) -> None:
        """Forget a peer that is there."""
        self._unlink(peer)
        del self.by_id[peer.peer_id]
        self._note(index, ChangeKind.REMOVED, peer)

    def _link(self, peer: PeerRecord) -> None:
        self.by_id[peer.peer_id] = peer
        self.keys.add(key_of(peer))
        if not peer.alive:
            self._dead[peer.peer_id] = None
        elif peer.name:
            self.ids[peer.name] = peer.peer_id

    def _unlink(self, peer: PeerRecord) -> None:
        self.keys.discard(key_of(peer))
        self._dead.pop(peer.peer_id, None)
        if peer.alive:
            self.ids.pop(peer.name, None)

    def _note(self, index: int, kind: ChangeKind, peer: PeerRecord) -> None:
        self.changes.append(DirectoryChange(index=index, kind=kind, subject=peer))


def key_of(peer: PeerRecord) -> PeerKey:
    """Where it comes in a listing."""
    return not peer.name, peer.name, peer.peer_id
