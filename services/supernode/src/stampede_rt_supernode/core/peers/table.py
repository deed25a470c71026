"""The peers of the directory, by id and by name (paper, sections 3.5 and 4.2). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from sortedcontainers import SortedDict, SortedSet

from stampede_rt_supernode.core.change_ring import ChangeRing
from stampede_rt_supernode.core.creators import Creators
from stampede_rt_supernode.core.records import ChangeKind, DirectoryChange, PeerRecord

DEAD_PEERS_MAX = 1000
# The order of listings: peers with names first, by name; then the others, by id.
PeerKey = tuple[bool, str, bytes]


class PeerTable:
    """The peers. The last DEAD_PEERS_MAX peers whose lease has ended stay, so that operators can list them.

    Changes are noted in a ring of their own. So thousands of peers that come and go do not push out the changes of
    channels.
    """

    def __init__(self, peers: Iterable[PeerRecord], index: int) -> None:
        self.changes = ChangeRing(index)
        self.creators = Creators()  # counts live peers only
        self.by_id: dict[bytes, PeerRecord] = {}
        self.ids: SortedDict[str, bytes] = SortedDict()  # the peer's id by its name, for all live peers with a name
        self.keys: SortedSet[PeerKey] = SortedSet()  # all peers, in the order of listings
        # The ids of the peers whose lease has ended, the earliest first; leases that one log entry ended are sorted by
        # id.
        self._dead: dict[bytes, None] = {}
        for peer in sorted(peers, key=lambda one: (one.ended_index, one.peer_id)):
            self._link(peer)

    def __len__(self) -> int:
        return len(self.by_id)

    @property
    def live_count(self) -> int:
        """The number of live peers."""
        return len(self.by_id) - len(self._dead)

    def live(self) -> Iterator[PeerRecord]:
        """The live peers, in no particular order."""
        return (peer for peer in self.by_id.values() if peer.alive)

    def live_named(self, name: str) -> PeerRecord | None:
        """The live peer of that name; None if no live peer has it."""
        found = self.ids.get(name)
        return None if found is None else self.by_id[found]

    def put(self, peer: PeerRecord, index: int) -> None:
        """Add or replace the peer of that id, as of log position `index`. No other live peer may have its name."""
        before = self.by_id.get(peer.peer_id)
        if before is not None:
            self._unlink(before)
        self._link(peer)
        self._note(index, ChangeKind.ADDED if before is None else ChangeKind.UPDATED, peer)
        if len(self._dead) > DEAD_PEERS_MAX:
            self.remove(self.by_id[next(iter(self._dead))], index)

    def remove(self, peer: PeerRecord, index: int) -> None:
        """Remove a peer that exists."""
        self._unlink(peer)
        del self.by_id[peer.peer_id]
        self._note(index, ChangeKind.REMOVED, peer)

    def _link(self, peer: PeerRecord) -> None:
        self.by_id[peer.peer_id] = peer
        self.keys.add(key_of(peer))
        if not peer.alive:
            self._dead[peer.peer_id] = None
            return
        self.creators.note(peer.created_by, +1)
        if peer.name:
            self.ids[peer.name] = peer.peer_id

    def _unlink(self, peer: PeerRecord) -> None:
        self.keys.discard(key_of(peer))
        self._dead.pop(peer.peer_id, None)
        if peer.alive:
            self.creators.note(peer.created_by, -1)
            self.ids.pop(peer.name, None)

    def _note(self, index: int, kind: ChangeKind, peer: PeerRecord) -> None:
        self.changes.append(DirectoryChange(index=index, kind=kind, subject=peer))


def key_of(peer: PeerRecord) -> PeerKey:
    """The sort key of a peer in a listing."""
    return not peer.name, peer.name, peer.peer_id
