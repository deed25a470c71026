"""The accepted items that are not archived yet. Retention keeps them in memory. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.oldest_items import OldestItems, below


class ArchiveBacklog:
    """The items of a channel from the seq `archived_to` on."""

    __slots__ = ("_held", "_low", "_seen_to", "archived_to")

    def __init__(self, held: Holdings, archived_to: int) -> None:
        self._held = held
        self.archived_to = self._seen_to = archived_to
        self._low: ItemKey | None = None

    def archived(self, end_seq: int) -> None:
        """Note that all items below `end_seq` are archived, or lost to the archive."""
        self.archived_to = self._seen_to = end_seq
        self._low = None

    @property
    def low(self) -> ItemKey | None:
        """The least key of an item in memory that is not archived, or None. Looks at each item once."""
        end_seq = self._held.next_seq
        for part in self._held.slices_by_seq(self._seen_to, end_seq):
            key = (part.first_time, part.first_seq)
            self._low = key if self._low is None else min(self._low, key)
        self._seen_to = end_seq
        return self._low


def low_of(backlog: ArchiveBacklog | None) -> ItemKey | None:
    """The least key of an item that is not archived. None: there is none, or the channel is not recorded."""
    return None if backlog is None else backlog.low


def archived_part(held: Holdings, oldest: OldestItems, backlog: ArchiveBacklog | None) -> OldestItems:
    """The oldest items that retention may collect: all items before the first one that is not archived."""
    low = low_of(backlog)
    if low is None or oldest.last is None or (oldest.last.last_time, oldest.last.end_seq) <= low:
        return oldest
    return held.oldest_items(below(low))
