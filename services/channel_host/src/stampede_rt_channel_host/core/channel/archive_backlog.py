"""The accepted items that are not archived yet. Retention keeps them in memory. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.oldest_items import OldestItems, below


class ArchiveBacklog:
    """The items of a channel from the seq `archived_to` on.

    `lost` counts the items that memory lost before a write had taken them. The archive will not have them, except the
    items of a run of which memory still has a part: a write takes whole runs. `at_risk` counts the items that memory
    has lost, and that the present write has taken. `lost_times` are the least and the greatest time of all these items
    since the last write that succeeded.
    """

    __slots__ = ("_held", "_low", "_seen_to", "_taken_to", "archived_to", "at_risk", "lost", "lost_times")

    def __init__(self, held: Holdings, archived_to: int) -> None:
        self._held = held
        self.archived_to = self._seen_to = self._taken_to = archived_to
        self._low: ItemKey | None = None
        self.lost = self.at_risk = 0
        self.lost_times: tuple[int, int] | None = None

    def archived(self, end_seq: int, named: int) -> None:
        """Note that all items below `end_seq` are archived, or lost to the archive. The archive names `named` of the
        lost items.
        """
        self.archived_to = self._seen_to = self._taken_to = end_seq
        self._low = None
        self.at_risk, self.lost_times = 0, None
        self.lost = max(0, self.lost - named) if end_seq < self._held.next_seq else 0

    def note_archived(self, end_seq: int, lost: int) -> None:
        """Note that a write has taken the items below `end_seq`, among them `lost` items that memory has lost."""
        self._taken_to = end_seq
        self.at_risk = min(lost, self.lost)
        self.lost -= self.at_risk

    def write_failed(self) -> None:
        """Note the failure of the write that had taken items."""
        self._taken_to = self.archived_to
        self.lost, self.at_risk = self.lost + self.at_risk, 0

    def count_leaving(self, oldest: OldestItems) -> None:
        """Count the items among `oldest` that are not archived, because they are about to leave memory."""
        low = self.low
        if low is None or oldest.last is None or (end := (oldest.last.last_time, oldest.last.end_seq)) <= low:
            return
        for part in self._held.slices(low, end):
            unarchived = max(0, part.end_seq - max(part.first_seq, self.archived_to))
            if not unarchived:
                continue
            untaken = max(0, part.end_seq - max(part.first_seq, self._taken_to))
            self.lost += untaken
            self.at_risk += unarchived - untaken
            first, last = self.lost_times or (part.first_time, part.last_time)
            self.lost_times = min(first, part.first_time), max(last, part.last_time)

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


def count_leaving(backlog: ArchiveBacklog | None, oldest: OldestItems) -> None:
    """Count the items `oldest`, which max_bytes is about to collect, if the channel is recorded."""
    if backlog is not None:
        backlog.count_leaving(oldest)
