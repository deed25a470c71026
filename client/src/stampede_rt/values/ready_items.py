"""The items of a subscription that have come, and that the program has not taken. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from stampede_rt.values.answers import ItemBatch
from stampede_rt.values.model import Item


class ReadyItems:
    """Keeps runs as they came, until the program takes their first item or takes all items together."""

    def __init__(self) -> None:
        self.items = deque[Item]()
        """The items before those of the kept runs. A step of the subscription takes the first one."""
        self._runs = deque[Sequence[Item]]()

    def __bool__(self) -> bool:
        return bool(self.items or self._runs)

    def add(self, runs: Iterable[Sequence[Item]]) -> None:
        """Add the items of each run."""
        self._runs.extend(run for run in runs if run)

    def unpack(self) -> bool:
        """Make the items of the first run. Return False if there is no run."""
        if not self._runs:
            return False
        made = deque(self._runs[0])  # an exception of a signal handler meanwhile loses no item
        self.items = made
        self._runs.popleft()
        return True

    def take_all(self) -> ItemBatch:
        """Take all items."""
        runs = [[*self.items], *self._runs] if self.items else [*self._runs]
        self.items.clear()
        self._runs.clear()
        return ItemBatch(runs)


class SeenSeqs:
    """The seqs of items that came to a subscription."""

    def __init__(self) -> None:
        self.seqs = set[int]()

    def unseen(self, runs: Iterable[Sequence[Item]]) -> list[Item]:
        """Return the items that are new, and note their seqs."""
        unseen = [item for run in runs for item in run if item.seq not in self.seqs]
        self.seqs.update(item.seq for item in unseen)
        return unseen
