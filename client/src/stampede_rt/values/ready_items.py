"""The items of a subscription that have come, and that the program has not taken. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

from stampede_rt.values.answers import ItemBatch
from stampede_rt.values.model import Item


class _UnpackedRun(deque[Item]):
    """The items of `run` that the program has not taken. `ReadyItems` compares `run` with its first kept run: if they
    are the same, the kept run is unpacked already."""

    run: Sequence[Item] | None = None


class ReadyItems:
    """Keeps runs as they came, until the program takes their first item or takes all items together.

    An exception of a signal handler during `add` or `unpack` neither loses nor repeats an item.
    """

    def __init__(self) -> None:
        self.items = _UnpackedRun()
        """The items that come before the items of the kept runs. A step of the subscription takes the first item."""
        self._runs = deque[Sequence[Item]]()

    def __bool__(self) -> bool:
        self._drop_unpacked()
        return bool(self.items or self._runs)

    def add(self, runs: Iterable[Sequence[Item]]) -> None:
        """Add the items of each run."""
        self._runs.extend([run for run in runs if run])

    def unpack(self) -> bool:
        """Make the items of the first run. Return False if there is no run."""
        self._drop_unpacked()
        if not self._runs:
            return False
        made = _UnpackedRun(self._runs[0])
        made.run = self._runs[0]
        self.items = made
        self._drop_unpacked()
        return True

    def _drop_unpacked(self) -> None:
        if self._runs and self._runs[0] is self.items.run:
            self._runs.popleft()

    def take_all(self) -> ItemBatch:
        """Take all items."""
        self._drop_unpacked()
        runs = [[*self.items], *self._runs] if self.items else [*self._runs]
        self.items.clear()
        self._runs.clear()
        return ItemBatch(runs)


class SeenSeqs:
    """The seqs, with the times, of items that came to a subscription after its cursor."""

    def __init__(self) -> None:
        self._times: dict[int, int] = {}  # by seq

    def __len__(self) -> int:
        return len(self._times)

    def unseen(self, runs: Iterable[Sequence[Item]]) -> list[Item]:
        """Return the items that are new, and note their seqs."""
        unseen = [item for run in runs for item in run if item.seq not in self._times]
        self._times.update((item.seq, item.time) for item in unseen)
        return unseen

    def forget_before(self, next_seq: int, cut: int) -> None:
        """Forget the items that do not come again after a cursor: those before `cut` with a seq below `next_seq`.

        After a break the new stream may have a cursor before the last item of the former stream, because its host takes
        steps of other lengths.
        """
        self._times = {seq: time for seq, time in self._times.items() if seq >= next_seq or time >= cut}
