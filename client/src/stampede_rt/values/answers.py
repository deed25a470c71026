"""The answers to gets, and the batches of subscriptions: sequences of items in columns. Pure."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple, Protocol, overload, runtime_checkable

from stampede_rt.values.model import Item, Reason
from stampede_rt.values.timeline import ResolvedInterval

ABSENT = -1  # in a column of durations: the item has none
COLUMN_TYPES = {"time": "q", "duration": "q", "seq": "Q"}  # type codes of `array`: 8 bytes, signed and unsigned


@runtime_checkable
class _Columns(Protocol):
    def column(self, name: str) -> memoryview: ...
    def payload_list(self) -> list[bytes | None]: ...


class Columnar(Sequence[Item]):
    """A sequence of items that has columns, too. A column has an entry for each item, in the order of the items.

    `numpy.asarray(items.times)` copies nothing. The same is true of `durations` and `seqs`.
    """

    __slots__ = ()

    @property
    def times(self) -> memoryview:
        """The time of each item in nanoseconds since the epoch; read-only int64 values."""
        return self._column("time")

    @property
    def durations(self) -> memoryview:
        """The duration of each item in nanoseconds, -1 for none; read-only int64 values."""
        return self._column("duration")

    @property
    def seqs(self) -> memoryview:
        """The seq of each item; read-only uint64 values."""
        return self._column("seq")

    @property
    def payloads(self) -> list[bytes | None]:
        """The payload of each item; None for each in reads without payloads. Copies the payloads, and makes no Item."""
        return [payload for part in self._parts for payload in _payloads_of(part)]

    @property
    def _parts(self) -> Sequence[Sequence[Item]]:
        """The items, in one sequence or several."""
        raise NotImplementedError

    def _column(self, name: str) -> memoryview:
        return read_only(array(COLUMN_TYPES[name], b"".join(_column_of(part, name) for part in self._parts)))


class PastState(NamedTuple):
    """Facts about a channel as it was at an earlier instant.

    `advance`: the highest advance of the channel until that instant; None: none. `next_change`: when its host next
    accepted items or an advance; None: the host has not done so yet. `next_items`: the first seq of the items that the
    host accepted at `next_change`, and their earliest and latest time; None: it accepted an advance.
    """

    advance: int | None
    next_change: int | None
    next_items: tuple[int, int, int] | None


class ItemBatch(Columnar):
    """The items that one step of `Subscription.batches` returns, in the order in which the host sent them.

    The batch keeps the items in columns, and makes an Item when the program touches it. `times`, `durations`, `seqs`
    and `payloads` need no Item.
    """

    __slots__ = ("_items", "_runs")

    def __init__(self, runs: Sequence[Sequence[Item]]) -> None:
        """`runs`: the items of each run."""
        self._runs = runs
        self._items: list[Item] | None = None

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | Sequence[Item]:
        if self._items is None:
            self._items = [*self]
        return self._items[index]

    def __len__(self) -> int:
        return sum(map(len, self._runs))

    def __iter__(self) -> Iterator[Item]:
        return chain.from_iterable(self._runs)

    @property
    def _parts(self) -> Sequence[Sequence[Item]]:
        return self._runs

    def __repr__(self) -> str:
        return f"<ItemBatch: {len(self)}>"


class Items(Columnar):
    """The answer to a get: items in time order, or in reverse with `newest_first`, and facts about the answer.

    The answer keeps the items in columns, and makes an Item when the program touches it. `times`, `durations`, `seqs`
    and `payloads` need no Item.

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
    def _parts(self) -> Sequence[Sequence[Item]]:
        return (self._items,)

    def __repr__(self) -> str:
        reason = f", reason={self.reason}" if self.reason else ""
        return f"<Items: {len(self)}, complete={self.complete}{reason}>"


def read_only(column: array[int]) -> memoryview:
    """Return a read-only view of a column."""
    return memoryview(column).toreadonly()


def _column_of(items: Sequence[Item], name: str) -> memoryview:
    if isinstance(items, _Columns):
        return items.column(name)
    entries = (getattr(item, name) for item in items)
    return read_only(array(COLUMN_TYPES[name], (ABSENT if entry is None else entry for entry in entries)))


def _payloads_of(items: Sequence[Item]) -> list[bytes | None]:
    return items.payload_list() if isinstance(items, _Columns) else [item.payload for item in items]
