"""The latest changes of the directory, for watchers that ask for the changes after a log position. Pure and bounded."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import takewhile

from stampede_rt_supernode.core.records import (
    AccessChange,
    ChangeKind,
    ChannelRecord,
    DirectoryChange,
    GroupRecord,
    HostRecord,
    QueueRecord,
)

CHANGES_MAX = 16_384


@dataclass(frozen=True, slots=True)
class ChangePage:
    """Changes in order. The next page begins at `position`. All changes up to log position `index` are in this page or
    an earlier one.
    """

    changes: tuple[DirectoryChange, ...]
    position: int
    index: int


class ChangeRing:
    """Holds every change after `floor_index`, at most `changes_max` of them. Drops the oldest change to make room.

    Positions count the changes since the ring was made. A reader that reads from its last position on gets each change
    once. If the ring has dropped the next change for this reader, `read` returns None.
    """

    def __init__(self, floor_index: int = 0, *, changes_max: int = CHANGES_MAX) -> None:
        # The ring holds no change before this log position, and perhaps only some of the changes at this position.
        self.floor_index = floor_index
        self.end_index = floor_index  # all changes up to this log position are appended
        self._index = floor_index  # the log position of the changes that `note` appends
        self._changes: deque[DirectoryChange] = deque()
        self._dropped = 0  # the number of dropped changes, which is the position of the first held change
        self._changes_max = changes_max

    @property
    def end_position(self) -> int:
        """The position that the next appended change will have."""
        return self._dropped + len(self._changes)

    def begin(self, index: int) -> None:
        """Set the log position of the changes that `note` appends from now on.

        `index` must not be below the index of the last call.
        """
        self._index = index

    def note(
        self, kind: ChangeKind, subject: ChannelRecord | HostRecord | GroupRecord | QueueRecord | AccessChange
    ) -> None:
        """Append a change of the log position that `begin` named last."""
        self.append(DirectoryChange(index=self._index, kind=kind, subject=subject))

    def append(self, change: DirectoryChange) -> None:
        """Append a change.

        The change's index must not be below the index of the last change. A full ring drops its oldest change.
        """
        self._changes.append(change)
        if len(self._changes) > self._changes_max:
            self.floor_index = self._changes.popleft().index
            self._dropped += 1

    def note_index(self, index: int) -> None:
        """Note that all changes of log position `index` are appended."""
        self.end_index = max(self.end_index, index)

    def position_after(self, index: int) -> int | None:
        """The position of the first change after log position `index`. O(changes after `index`).

        None if the ring may lack a change after `index`.
        """
        if index < self.floor_index:
            return None
        later = takewhile(lambda change: change.index > index, reversed(self._changes))
        return self.end_position - sum(1 for _ in later)

    def read(self, position: int, changes_max: int) -> ChangePage | None:
        """Up to `changes_max` changes from `position` on; None if the ring has dropped the first of them."""
        start = position - self._dropped
        if start < 0:
            return None
        # Reads each change by its index, because a deque is fast near both ends. Nearly all readers are at the end, and
        # islice would count from the beginning for each reader.
        changes = tuple(self._changes[one] for one in range(start, min(start + changes_max, len(self._changes))))
        following = start + len(changes)
        index = self.end_index
        if following < len(self._changes):
            index = self._changes[following].index - 1  # the next page has changes of that log position
        return ChangePage(changes, position + len(changes), index)
