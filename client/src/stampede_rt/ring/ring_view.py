"""The words and bytes of a mapped ring, read safely. Pure.

The memory may change at any moment, and a defective host may have written anything. So this module checks each number
from the memory before it uses the number as a position.
"""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.ring.layout import (
    FACTS_END,
    FENCE_WORD,
    FIRST_TIME,
    HEAD,
    HEADER_WORDS,
    INCARNATION_WORD,
    OPEN,
    ORDERED_FROM,
    PAYLOAD_BEGIN_MAX,
    SEQUENCE_WORD,
    SLOT_WORDS,
    STATE_WORD,
    TAIL_WORD,
    size_of,
    words_of,
)

TRIES_MAX = 64  # the attempts to read the facts; the host writes them in microseconds, unless it is stopped meanwhile


class Slot(NamedTuple):
    """The words of a slot. `number` counts slots from 0."""

    number: int
    seq: int
    items: int
    first_time: int
    last_time: int
    offset: int
    length: int
    duration: int
    payload: int

    @property
    def is_plain(self) -> bool:
        """Whether the run has one item, without labels, and PAYLOAD tells where its payload is."""
        return self.items == 1 and self.payload > 0


class RingView:
    """A mapped ring."""

    __slots__ = ("_data", "_data_bytes", "_slots", "incarnation", "words")

    def __init__(self, memory: memoryview) -> None:
        """Raises InvalidArgument if the memory is not a ring of this layout."""
        size = size_of(memory)
        self.words = words_of(memory)
        self.incarnation = self.words[INCARNATION_WORD] & (2**64 - 1)
        self._slots, self._data_bytes = size.slots, size.data_bytes
        self._data = memory[size.data_begin :]

    def is_open(self, boottime: int) -> bool:
        """Whether the host still writes the ring and may serve at `boottime`, a reading of CLOCK_BOOTTIME."""
        return bool(self.words[STATE_WORD] == OPEN and boottime < self.words[FENCE_WORD])

    def facts(self) -> list[int] | None:
        """Return the facts as of one moment; None if the host did not finish writing them."""
        words = self.words
        for _ in range(TRIES_MAX):
            facts: list[int] = words[SEQUENCE_WORD:FACTS_END].tolist()
            if not facts[0] & 1 and words[SEQUENCE_WORD] == facts[0]:
                return facts
        return None

    def oldest_slot(self, facts: list[int]) -> int:
        """Return the number of the first slot that is whole. A slot is not whole if a later slot has taken its
        place."""
        return max(self.words[TAIL_WORD], facts[HEAD] - self._slots, 0)

    def first_ordered(self, facts: list[int]) -> int:
        """Return the number of the slot at and after which all items are in order."""
        return max(self.oldest_slot(facts), facts[ORDERED_FROM])

    def is_whole(self, number: int) -> bool:
        """Whether the bytes that the caller has read from the slot before this call are whole."""
        return bool(self.words[TAIL_WORD] <= number)

    def slot(self, number: int) -> Slot:
        """Return a slot. The caller checks afterwards that it is whole."""
        begin = HEADER_WORDS + (number & (self._slots - 1)) * SLOT_WORDS
        return Slot(number, *self.words[begin : begin + SLOT_WORDS].tolist())

    def first_time(self, number: int) -> int:
        """Return the time of the first item of a slot."""
        time: int = self.words[HEADER_WORDS + (number & (self._slots - 1)) * SLOT_WORDS + FIRST_TIME]
        return time

    def first_seq(self, number: int) -> int:
        """Return the seq of the first item of a slot."""
        seq: int = self.words[HEADER_WORDS + (number & (self._slots - 1)) * SLOT_WORDS]
        return seq

    def copy(self, slot: Slot) -> bytes | None:
        """Return the slot's run; None if the numbers in the slot lead outside of the data."""
        at = slot.offset % self._data_bytes
        if not 0 < slot.length <= self._data_bytes - at:
            return None
        return bytes(self._data[at : at + slot.length])

    def copy_item(self, slot: Slot) -> bytes | None:
        """Return the payload of a plain slot, or the run of another slot. None in the same cases as `copy`."""
        return self.copy_payload(slot) if slot.is_plain else self.copy(slot)

    def copy_payload(self, slot: Slot) -> bytes | None:
        """Return the payload of a slot with PAYLOAD; None if the numbers in the slot lead outside of the run."""
        at, begin, length = slot.offset % self._data_bytes, slot.payload & PAYLOAD_BEGIN_MAX, slot.payload >> 16
        if not 0 < begin + length <= slot.length <= self._data_bytes - at:
            return None
        return bytes(self._data[at + begin : at + begin + length])
