"""Brings items into the order of their seqs, from datagrams and from the answers of the host. Pure."""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable, Sequence
from typing import Generic, Protocol, TypeVar


class HasSeq(Protocol):
    """An item."""

    @property
    def seq(self) -> int:
        """The item's number in its channel."""
        ...


OneItem = TypeVar("OneItem", bound=HasSeq)


class _HeldMessage(Generic[OneItem]):
    """The items of one message, which wait for earlier ones. Ordered by the first seq."""

    __slots__ = ("bytes", "end_seq", "first_seq", "items")

    def __init__(self, first_seq: int, end_seq: int, items: Sequence[OneItem], size: int) -> None:
        self.first_seq, self.end_seq, self.items, self.bytes = first_seq, end_seq, items, size

    def __lt__(self, other: _HeldMessage[OneItem]) -> bool:
        return self.first_seq < other.first_seq


class SeqMerge(Generic[OneItem]):
    """The items of one reader, whose next item has the seq `next_seq`.

    `announced_seq`: the host has told the reader that there are items below this seq. `held_bytes`: the memory of the
    messages that wait for earlier items, at most `bytes_max`. `taken`: how many items of messages the reader has got.
    """

    def __init__(self, next_seq: int, bytes_max: int) -> None:
        self.next_seq = self.announced_seq = next_seq
        self.held_bytes = self.taken = 0
        self._bytes_max = bytes_max
        self._held: list[_HeldMessage[OneItem]] = []

    @property
    def is_missing(self) -> bool:
        """Whether there is an item that the reader does not have."""
        return self.announced_seq > self.next_seq

    @property
    def is_contiguous(self) -> bool:
        """Whether no item is missing before the first held one. Then the next item comes by multicast."""
        return not self.is_missing or bool(self._held and self._held[0].first_seq <= self.next_seq)

    @property
    def missing_items(self) -> int:
        """The number of items that are missing before the first held item, or before the announced seq."""
        return max(0, (self._held[0].first_seq if self._held else self.announced_seq) - self.next_seq)

    def announce(self, end_seq: int) -> None:
        """Note that there are items below `end_seq`."""
        self.announced_seq = max(self.announced_seq, end_seq)

    def add(self, first_seq: int, end_seq: int, items: Sequence[OneItem], size: int) -> bool:
        """Hold the items of a message with the seqs from `first_seq` up to `end_seq`. False if they are not new.

        Beyond the bound drops the latest messages. The reader asks the host for their items later.
        """
        self.announce(end_seq)
        if end_seq <= self.next_seq or any(one.first_seq == first_seq and one.end_seq >= end_seq for one in self._held):
            return False
        insort(self._held, _HeldMessage(first_seq, end_seq, items, size))
        self.held_bytes += size
        while self.held_bytes > self._bytes_max:
            self.held_bytes -= self._held.pop().bytes
        return True

    def take(self) -> list[OneItem]:
        """Return the items that come next, up to the first missing one."""
        taken: list[OneItem] = []
        count = 0
        for one in self._held:
            if one.first_seq > self.next_seq:
                break
            count += 1
            self.held_bytes -= one.bytes
            taken += [item for item in one.items if item.seq >= self.next_seq]
            self.next_seq = max(self.next_seq, one.end_seq)
        del self._held[:count]
        self.taken += len(taken)
        return taken

    def fill(self, items: Iterable[OneItem]) -> list[OneItem]:
        """Return the items of the host's answer that the reader does not have. Their seqs ascend."""
        new = [item for item in items if item.seq >= self.next_seq]
        if new:
            self.pass_to(new[-1].seq + 1)
        return new

    def pass_to(self, next_seq: int) -> None:
        """Note that the host has sent or reported all items below `next_seq`."""
        self.next_seq = max(self.next_seq, next_seq)
        self.announce(self.next_seq)
        while self._held and self._held[0].end_seq <= self.next_seq:
            self.held_bytes -= self._held.pop(0).bytes

    def take_up_to(self, end_seq: int) -> list[OneItem]:
        """Return the held items below `end_seq`, and continue there: the host has reported the others as missing."""
        taken: list[OneItem] = []
        while self._held and self._held[0].first_seq < end_seq:
            self.pass_to(self._held[0].first_seq)
            taken += self.take()
        self.pass_to(end_seq)
        return taken
