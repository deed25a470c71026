"""Pages of the directory's peers. Pure. O(page), for any pattern."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_supernode.core import queries
from stampede_rt_supernode.core.glob import fixed_prefix, matcher
from stampede_rt_supernode.core.peers.table import PeerKey
from stampede_rt_supernode.core.records import PeerRecord
from stampede_rt_supernode.core.tables import Tables

BEGINNING: PeerKey = (False, "", b"")


@dataclass(frozen=True, slots=True)
class PeerPage:
    """Peers by name, then peers without a name. The next page begins after `last`, which is None for the last page."""

    peers: tuple[PeerRecord, ...]
    last: PeerKey | None


def peer_page(tables: Tables, glob: str, after: PeerKey, peers_max: int, *, include_dead: bool) -> PeerPage:
    """Up to `peers_max` (0: PAGE_SIZE_MAX) peers after `after` whose names match `glob`.

    With an empty `glob`, peers without a name come after the peers with a name. A page may be short, even empty, and
    yet not be the last. Raises InvalidArgument for an invalid pattern.
    """
    matches, limit = matcher(glob), min(peers_max or queries.PAGE_SIZE_MAX, queries.PAGE_SIZE_MAX)
    prefix = fixed_prefix(glob)
    found: list[PeerRecord] = []
    last: PeerKey | None = None
    first = max(after, (False, prefix, b""))
    for examined, key in enumerate(tables.peers.keys.irange(minimum=first, inclusive=(first != after, True)), start=1):
        nameless, name, peer_id = key
        if glob and (nameless or not name.startswith(prefix)):
            break
        if len(found) == limit or examined > queries.NAMES_EXAMINED_MAX:
            return PeerPage(tuple(found), last)
        last = key
        peer = tables.peers.by_id[peer_id]
        if (peer.alive or include_dead) and matches(name):
            found.append(peer)
    return PeerPage(tuple(found), None)
