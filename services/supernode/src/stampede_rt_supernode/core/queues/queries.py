"""Queries about queues: pages of all queues, and the queues of one host. Pure. O(page), for any pattern."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice

from stampede_rt_supernode.core import queries
from stampede_rt_supernode.core.glob import fixed_prefix, matcher
from stampede_rt_supernode.core.records import QueueRecord
from stampede_rt_supernode.core.tables import Tables

HOST_QUEUES_MAX = 1000
# A position in a listing: whether it is among the mailboxes, which come last, and the name of the queue or peer.
Position = tuple[bool, str]
BEGINNING: Position = (False, "")


@dataclass(frozen=True, slots=True)
class QueuePage:
    """Queues by name, then mailboxes by their peers' names. `positions` has the position of each.

    The next page begins after `last`, which is None for the last page.
    """

    queues: tuple[QueueRecord, ...]
    positions: tuple[Position, ...]
    last: Position | None


def queue_page(tables: Tables, glob: str, after: Position, queues_max: int, *, mailboxes: bool) -> QueuePage:
    """Up to `queues_max` (0: PAGE_SIZE_MAX) queues after `after` whose names match `glob`.

    `mailboxes`: adds the mailboxes, by the names of their peers. A page may be short, even empty, and yet not be the
    last. Raises InvalidArgument for an invalid pattern.
    """
    matches, limit = matcher(glob), min(queues_max or queries.PAGE_SIZE_MAX, queries.PAGE_SIZE_MAX)
    found: list[QueueRecord] = []
    positions: list[Position] = []
    last: Position | None = None
    for examined, (position, queue) in enumerate(_entries_after(tables, glob, after, mailboxes), start=1):
        if len(found) == limit or examined > queries.NAMES_EXAMINED_MAX:
            return QueuePage(tuple(found), tuple(positions), last)
        last = position
        if matches(position[1]):
            found.append(queue)
            positions.append(position)
    return QueuePage(tuple(found), tuple(positions), None)


def _entries_after(
    tables: Tables, glob: str, after: Position, mailboxes: bool
) -> Iterator[tuple[Position, QueueRecord]]:
    prefix, (among_mailboxes, name) = fixed_prefix(glob), after
    named: Iterator[tuple[Position, QueueRecord]] = iter(())
    if not among_mailboxes:
        names = queries.names_from(tables.queues.ids, prefix, name)
        named = (((False, one), tables.queues.by_id[tables.queues.ids[one]]) for one in names)
    if not mailboxes:
        return named
    peers = queries.names_from(tables.peers.ids, prefix, name if among_mailboxes else "")
    return chain(named, (((True, one), _mailbox_of(tables, one)) for one in peers))


def _mailbox_of(tables: Tables, peer_name: str) -> QueueRecord:
    """The mailbox of a live peer. Every live peer with a name has one."""
    mailbox_id = tables.peers.by_id[tables.peers.ids[peer_name]].mailbox_queue_id
    assert mailbox_id is not None
    return tables.queues.by_id[mailbox_id]


def queues_of(tables: Tables, host_id: bytes) -> tuple[QueueRecord, ...]:
    """The queues and mailboxes that a host owns: the first HOST_QUEUES_MAX in the order of their ids."""
    return tuple(islice(tables.queues.at(host_id), HOST_QUEUES_MAX))
