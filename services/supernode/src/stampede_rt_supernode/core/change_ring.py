"""The recent changes of the directory, for watchers that ask for what came after a log position. Pure and bounded."""

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
    """Changes in order; `position` continues behind them; everything up to `index` has been given out with them."""

    changes: tuple[DirectoryChange, ...]
    position: int
    index: int


class ChangeRing:
    """Holds every change after `floor_index`, at most `changes_max` of them; the oldest go first.

    Positions count changes since this ring was made; a reader holds one and never meets a gap or a double.
    """

    def __init__(self, floor_index: int = 0, *, changes_max: int = CHANGES_MAX) -> None:
        self.floor_index = floor_index  # no change at or below it is held, and perhaps not all of those at it were
        self.end_index = floor_index  # the last log position noted, with or without a change
        self._index = floor_index  # the one whose changes are being noted
        self._changes: deque[DirectoryChange] = deque()
        self._dropped = 0  # changes that went; the first held one has this position
        self._changes_max = changes_max

    @property
    def end_position(self) -> int:
        """Behind the newest change."""
        return self._dropped + len(self._changes)

    def begin(self, index: int) -> None:
        """Note the following changes under log position `index`, which is not below the one before."""
        self._index = index

    def note(
        self, kind: ChangeKind, subject: ChannelRecord | HostRecord | GroupRecord | QueueRecord | AccessChange
    ) -> None:
        """Append a change of the present log position."""
        self.append(DirectoryChange(index=self._index, kind=kind, subject=subject))

    def append(self, change: DirectoryChange) -> None:
        """Note a change; its index is not below that of the one before. The oldest one goes if there is no room."""
        self._changes.append(change)
        if len(self._changes) > self._changes_max:
            self.floor_index = self._changes.popleft().index
            self._dropped += 1

    def note_index(self, index: int) -> None:
        """All changes of log position `index` have been appended."""
        self.end_index = max(self.end_index, index)

    def position_after(self, index: int) -> int | None:
        """Where the changes after `index` begin, or None if they are not all held. O(changes after it)."""
        if index < self.floor_index:
            return None
        later = takewhile(lambda change: change.index > index, reversed(self._changes))
        return self.end_position - sum(1 for _ in later)

    def read(self, position: int, changes_max: int) -> ChangePage | None:
        """Up to `changes_max` changes from `position` on, or None if they are not held any more."""
        start = position - self._dropped
        if start < 0:
            return None
        # By position, which is near at both ends of a deque: nearly all readers are at its end, and islice would walk
        # there from the beginning for each of them.
        changes = tuple(self._changes[one] for one in range(start, min(start + changes_max, len(self._changes))))
        following = start + len(changes)
        index = self.end_index
        if following < len(self._changes):
            index = self._changes[following].index - 1  # of that log position not all is given out, perhaps
        return ChangePage(changes, position + len(changes), index)
