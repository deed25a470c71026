"""Writes a ring in shared memory (`stampede_rt.ring.layout`). Pure: the memory comes from the caller."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from stampede_rt.ring.layout import (
    ABSENT_INSTANT,
    CHANGES_WORD,
    CLOCK_BOOTTIME,
    CLOSED,
    DATA_BYTES_WORD,
    FENCE_WORD,
    HEADER_WORDS,
    INCARNATION_WORD,
    LAYOUT_VERSION,
    MAGIC,
    MAGIC_WORD,
    NO_ITEMS,
    NOT_HERE,
    OPEN,
    SEQUENCE_WORD,
    SLOT_WORDS,
    SLOTS_WORD,
    STATE_WORD,
    TAIL_WORD,
    VERSION_WORD,
    WORD_BYTES,
    RingSize,
    words_of,
)

_DATA_SHARE_MAX = 4
"""A ring takes no run that is longer than a quarter of its data, because a reader needs time to copy a run."""
_SLOT_BYTES = 512  # the data for each slot: a guess of the length of a usual run
_PAGE_BYTES = 4096


class BodyInParts(Protocol):
    """An encoded run in parts, which the ring joins."""

    @property
    def parts(self) -> Sequence[bytes]:
        """The parts, in their order."""

    def __len__(self) -> int: ...


class RingRun(NamedTuple):
    """Items whose times ascend in the order of acceptance. `body`: the encoded run with exactly these items.

    `duration` and `payload`: see `layout`; they count only for a single item.
    """

    first_seq: int
    items: int
    first_time: int
    last_time: int
    body: bytes | BodyInParts
    duration: int = -1
    payload: int = 0


class RingFacts(NamedTuple):
    """The facts about a channel that a ring shows to readers, see `layout`. None: the instant or the limit is absent.

    `has_items`: in memory, or perhaps in the archive. `is_recorded`: the channel has an archive.
    """

    next_seq: int
    has_items: bool
    passed: int | None
    gone_before: int | None
    floor: tuple[int, int]
    max_age_nanos: int | None
    has_overlap: bool
    is_recorded: bool = False


class ClockReading(NamedTuple):
    """The host's clock at one reading of CLOCK_BOOTTIME, and how far the wall clock is ahead of it, in nanoseconds."""

    boottime: int
    host_unix: int
    offset: int


def ring_size(data_bytes_min: int) -> RingSize:
    """The size of a ring with at least `data_bytes_min` bytes of data."""
    data_bytes = -(-data_bytes_min // _PAGE_BYTES) * _PAGE_BYTES
    slots = 1 << max(6, (data_bytes // _SLOT_BYTES).bit_length() - 1)
    return RingSize(slots, data_bytes)


class RingWriter:
    """The only writer of a ring. All bytes of `memory` are zero at first."""

    def __init__(self, memory: memoryview, size: RingSize, incarnation: int, newest_time: int | None) -> None:
        """`newest_time`: the time of the channel's newest item. The caller first appends the held items, in order."""
        self._words = words_of(memory)
        self._data = memory[size.data_begin :]
        self._size = size
        self._head = self._tail = self._offset = 0
        self._kept: deque[int] = deque()  # the offsets of the whole slots, from the tail on
        self._newest_slot = NO_ITEMS if newest_time is None else NOT_HERE
        self._newest_time = ABSENT_INSTANT if newest_time is None else newest_time
        self._is_filled = newest_time is None
        self._ordered_from = self._late = 0
        words = self._words
        words[MAGIC_WORD], words[VERSION_WORD] = MAGIC, LAYOUT_VERSION
        words[SLOTS_WORD], words[DATA_BYTES_WORD] = size.slots, size.data_bytes
        words[INCARNATION_WORD] = incarnation - 2**64 if incarnation >= 2**63 else incarnation
        words[STATE_WORD] = OPEN

    def takes(self, body_bytes: int) -> bool:
        """Whether the ring takes a run of that length."""
        return body_bytes <= self._size.data_bytes // _DATA_SHARE_MAX

    def append(self, run: RingRun) -> None:
        """Write a run that `takes` allows. Readers see it after the next `publish`."""
        begin = self._make_room(len(run.body))
        at = begin % self._size.data_bytes
        for part in (run.body,) if isinstance(run.body, bytes) else run.body.parts:
            self._data[at : at + len(part)] = part
            at += len(part)
        self._offset = begin + -(-len(run.body) // WORD_BYTES) * WORD_BYTES
        self._write_slot(run, begin)
        self._kept.append(begin)
        self._order(run)
        self._head += 1

    def _write_slot(self, run: RingRun, begin: int) -> None:
        words, word = self._words, HEADER_WORDS + (self._head & (self._size.slots - 1)) * SLOT_WORDS
        item_facts = run.first_seq, run.items, run.first_time, run.last_time
        values = (*item_facts, begin, len(run.body), run.duration, run.payload)
        for place, value in enumerate(values, start=word):
            words[place] = value

    def _order(self, run: RingRun) -> None:
        """Note whether the run comes after the newest item in time, and which slot has the newest item."""
        if run.first_time < self._newest_time and self._is_filled:
            self._late += 1
            self._ordered_from = self._head + 1
        if run.last_time >= self._newest_time:
            self._newest_slot, self._newest_time = self._head, run.last_time
            self._is_filled = True

    def _make_room(self, body_bytes: int) -> int:
        """Make room for a run, and return its offset.

        First moves the tail past all slots whose bytes the run overwrites.
        """
        data_bytes, begin = self._size.data_bytes, self._offset
        if begin % data_bytes + body_bytes > data_bytes:
            begin += data_bytes - begin % data_bytes
        first_whole = begin + body_bytes - data_bytes
        while self._kept and (self._kept[0] < first_whole or len(self._kept) >= self._size.slots):
            self._kept.popleft()
            self._tail += 1
        self._words[TAIL_WORD] = self._tail
        return begin

    def publish(self, facts: RingFacts, clock: ClockReading) -> None:
        """Show the appended runs and the facts to readers. The caller must then wake the waiting readers."""
        if not facts.has_items:
            self._newest_slot = NO_ITEMS
        elif self._newest_slot == NO_ITEMS:
            self._newest_slot = NOT_HERE
        values = (
            self._head,
            self._newest_slot,
            self._newest_time,
            facts.next_seq,
            self._head if facts.has_overlap else self._ordered_from,
            ABSENT_INSTANT if facts.passed is None else facts.passed,
            ABSENT_INSTANT if facts.gone_before is None else facts.gone_before,
            *facts.floor,
            -1 if facts.max_age_nanos is None else facts.max_age_nanos,
            *clock,
            self._late,
            int(facts.is_recorded),
        )
        words = self._words
        sequence = words[SEQUENCE_WORD] + 1
        words[SEQUENCE_WORD] = sequence
        for place, value in enumerate(values, start=SEQUENCE_WORD + 1):
            words[place] = value
        words[SEQUENCE_WORD] = sequence + 1
        words[CHANGES_WORD] = (words[CHANGES_WORD] + 1) & 0xFFFF_FFFF

    def note_clock(self, clock: ClockReading) -> None:
        """Show a later reading of the clocks to readers. The caller need not wake waiting readers."""
        words = self._words
        sequence = words[SEQUENCE_WORD] + 1
        words[SEQUENCE_WORD] = sequence
        for place, value in enumerate(clock, start=SEQUENCE_WORD + CLOCK_BOOTTIME):
            words[place] = value
        words[SEQUENCE_WORD] = sequence + 1

    def set_fence(self, boottime: int) -> None:
        """Set the instant until which the host may serve, in nanoseconds of CLOCK_BOOTTIME."""
        self._words[FENCE_WORD] = boottime

    def release(self) -> None:
        """Release the memory. The caller must not use the writer afterwards."""
        self._words.release()
        self._data.release()

    def close(self) -> None:
        """Tell readers that the host no longer writes this ring. The caller must then wake the waiting readers."""
        words = self._words
        words[STATE_WORD] = CLOSED
        words[CHANGES_WORD] = (words[CHANGES_WORD] + 1) & 0xFFFF_FFFF
