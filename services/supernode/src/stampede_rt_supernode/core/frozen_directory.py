"""What a snapshot is written from while the directory goes on: copies that stand still. Pure.

The values are immutable, so it is enough to copy what holds them. Of the channels, of which there may be very many,
only the changes since the snapshot before are taken, as long as they are all kept: a few milliseconds for any number.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TypeVar

from stampede_rt_supernode.core.change_ring import CHANGES_MAX
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.records import ChannelRecord, DirectoryChange

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Still:
    """A directory as of one log position. `directory` has no channels, and is good for reading in order alone."""

    directory: Directory
    channels: tuple[ChannelRecord, ...]  # all of them, in no order; or none, with `changes`
    changes: tuple[DirectoryChange, ...] | None  # those of all kinds since the position that was named
    position: int  # behind the newest change


def frozen(directory: Directory, since_position: int | None = None) -> Still:
    """The directory as of now; of its channels, what changed since `since_position`, a position of `tables.changes`.

    O(changes) for the channels, or O(channels) without a position and when not all changes since then are held.
    """
    ring = directory.tables.changes
    page = None if since_position is None else ring.read(since_position, CHANGES_MAX)
    channels = tuple(directory.tables.channels.values()) if page is None else ()
    return Still(_but_channels(directory), channels, None if page is None else page.changes, ring.end_position)


def _but_channels(directory: Directory) -> Directory:
    still = copy(directory)
    still.tables = _with_copies(directory.tables, "hosts")
    still.tables.channels = {}
    still.tables.groups = _with_copies(directory.tables.groups, "ids", "_entries")
    still.tables.replicas = _with_copies(directory.tables.replicas, "_by_channel")
    still.tables.queues = _with_copies(directory.tables.queues, "by_id")
    still.tables.peers = _with_copies(directory.tables.peers, "by_id")
    still.answered = _with_copies(directory.answered, "_answers")
    return still


def _with_copies(holder: T, *names: str) -> T:
    """`holder` with these dictionaries copied; sorted ones become plain ones in the same order."""
    still = copy(holder)
    for name in names:
        table = getattr(holder, name)
        setattr(still, name, table.copy() if type(table) is dict else dict(table.items()))
    return still
