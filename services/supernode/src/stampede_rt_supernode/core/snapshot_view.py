"""A view of the directory that does not change, for writing a snapshot while the directory changes. Pure.

The records are immutable, so the view copies only the tables that hold them. There may be very many channels. So the
view does not copy the table of channels, if the directory still holds all changes since the last snapshot; it takes
these changes instead. That takes a few milliseconds for any number of channels.
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
class SnapshotView:
    """A directory as of one log position.

    `directory` has no channels. Its sorted maps are plain dictionaries in the same order, so they can be iterated, but
    not searched by range.
    """

    directory: Directory
    channels: tuple[ChannelRecord, ...]  # all channels, in no particular order; or none if `changes` is set
    changes: tuple[DirectoryChange, ...] | None  # changes of all kinds since the position of the last snapshot
    position: int  # the position in `tables.changes` after the newest change


def snapshot_view(directory: Directory, since_position: int | None = None) -> SnapshotView:
    """A view of the present directory.

    `since_position`: the `position` of the view of the last snapshot; None for the first. The view has the changes
    since that position, in O(changes). Without a position, or if the directory has dropped some of these changes, the
    view has all channels, in O(channels).
    """
    ring = directory.tables.changes
    page = None if since_position is None else ring.read(since_position, CHANGES_MAX)
    channels = tuple(directory.tables.channels.values()) if page is None else ()
    return SnapshotView(
        _without_channels(directory), channels, None if page is None else page.changes, ring.end_position
    )


def _without_channels(directory: Directory) -> Directory:
    view = copy(directory)
    view.tables = _with_copies(directory.tables, "hosts")
    view.tables.channels = {}
    view.tables.groups = _with_copies(directory.tables.groups, "ids", "_entries")
    view.tables.replicas = _with_copies(directory.tables.replicas, "_by_channel")
    view.tables.queues = _with_copies(directory.tables.queues, "by_id")
    view.tables.peers = _with_copies(directory.tables.peers, "by_id")
    view.kept_answers = _with_copies(directory.kept_answers, "_answers")
    return view


def _with_copies(holder: T, *names: str) -> T:
    """A copy of `holder` with copies of these dictionaries.

    A sorted dictionary becomes a plain dictionary in the same order.
    """
    view = copy(holder)
    for name in names:
        table = getattr(holder, name)
        setattr(view, name, table.copy() if type(table) is dict else dict(table.items()))
    return view
