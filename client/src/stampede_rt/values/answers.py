"""The answers to gets, and the batches of subscriptions: sequences of items in columns. Pure."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol, overload, runtime_checkable

from stampede_rt.values.model import Item, Reason
from stampede_rt.values.timeline import ResolvedInterval

ABSENT = -1  # in a column of durations: the item has none
COLUMN_TYPES = {"time": "q", "duration": "q", "seq": "Q"}  # type codes of `array`: 8 bytes, signed and unsigned


@runtime_checkable
class _Columnar(Protocol):
    def column(self, name: str) -> memoryview: ...


class PastState(NamedTuple):
    """Facts about a channel as it was at an earlier instant.

    `advance`: the highest instant that its producers had promised to pass by then; None: none. `next_change`: when its
    host next accepted items or an advance; None: it has not done so yet. `next_items`: the first seq of the items that
    it accepted at that instant, and their earliest and latest time; None: it accepted an advance.
    """

    advance: int | None
    next_change: int | None
    next_items: tuple[int, int, int] | None


class Items(Sequence[Item]):
    """The answer to a get: items in time order, or in reverse with `newest_first`, and facts about the answer.

    The answer keeps the items in columns, and makes an Item when the program touches it. `times`, `durations` and
    `seqs` need no Item.

    - `interval`: the interval as the host resolved it. None if a bound is NEWEST or OLDEST and the channel has no
      items.
    - `complete`: no more items can come into the interval.
    - `truncated`: the interval begins before the frontier, so retention may have collected items at its beginning.
    - `more`: the limit left out items.
    - `reason`: why the answer is empty or partial; None if nothing is missing.
    - `cut`: for reads through a group, its cut, exclusive. None for other reads, and while the group shows nothing.
    - `past`: facts about the channel as it was then, for reads with `as_of`. None for other reads.
    - `staleness_nanos`: a copy of the channel has answered, and its state was at most this old; None: the owner has
      answered.
    """

    __slots__ = (
        "_items",
        "complete",
        "cut",
        "incarnation",
        "interval",
        "more",
        "past",
        "reason",
        "staleness_nanos",
        "truncated",
    )

    def __init__(
        self,
        items: Sequence[Item],
        *,
        interval: ResolvedInterval | None,
        complete: bool,
        truncated: bool,
        more: bool,
        reason: Reason | None,
        incarnation: int,
        cut: int | None = None,
        staleness_nanos: int | None = None,
        past: PastState | None = None,
    ) -> None:
        self._items = items
        self.interval = interval
        self.complete = complete
        self.truncated = truncated
        self.more = more
        self.reason = reason
        self.incarnation = incarnation
        self.cut = cut
        self.staleness_nanos = staleness_nanos
        self.past = past

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | Sequence[Item]:
        return self._items[index]

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)

    @property
    def times(self) -> memoryview:
        """The time of each item in nanoseconds since the epoch, in the order of the items; read-only int64 values.

        `numpy.asarray(items.times)` copies nothing. The same is true of the other columns.
        """
        return self._column("time")

    @property
    def durations(self) -> memoryview:
        """The duration of each item in nanoseconds, -1 for none; read-only int64 values."""
        return self._column("duration")

    @property
    def seqs(self) -> memoryview:
        """The seq of each item; read-only uint64 values."""
        return self._column("seq")

    def _column(self, name: str) -> memoryview:
        if isinstance(self._items, _Columnar):
            return self._items.column(name)
        entries = (getattr(item, name) for item in self._items)
        return read_only(array(COLUMN_TYPES[name], (ABSENT if entry is None else entry for entry in entries)))

    def __repr__(self) -> str:
        reason = f", reason={self.reason}" if self.reason else ""
        return f"<Items: {len(self)}, complete={self.complete}{reason}>"


def read_only(column: array[int]) -> memoryview:
    """Return a read-only view of a column."""
    return memoryview(column).toreadonly()
