"""A ring's reader: torn copies, damaged numbers, and hosts that stopped."""

from __future__ import annotations

import random
from contextlib import suppress

import pytest

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.ring.facts import host_now
from stampede_rt.ring.layout import HEADER_WORDS, SEQUENCE_WORD, SLOT_WORDS, RingSize, words_of
from stampede_rt.ring.newest import FoundNewest, find_newest
from stampede_rt.ring.ring_view import RingView
from stampede_rt.ring.selecting import Columns, select
from stampede_rt.ring.successors import find_next
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import Bound, Interval
from stampede_rt_channel_host.core.ring_writer import ClockReading, RingFacts, RingRun, RingWriter, ring_size

SIZE = RingSize(8, 1024)
BOOTTIME = 10**9


class Ring:
    """A ring in plain memory, with its writer and a reader."""

    def __init__(self) -> None:
        self.memory = memoryview(bytearray(SIZE.whole_bytes))
        self.writer = RingWriter(self.memory, SIZE, 2**63 + 5, None)
        self.view = RingView(self.memory.toreadonly())
        self.seq = 0

    def put(self, time: int, body: bytes = b"x" * 64) -> None:
        self.seq += 1
        self.writer.append(RingRun(self.seq, 1, time, time, body, -1, len(body) << 16))
        self.publish()

    def publish(self) -> None:
        facts = RingFacts(self.seq + 1, self.seq > 0, None, None, (-(2**63), 0), None, False)
        self.writer.publish(facts, ClockReading(BOOTTIME, 1000, 0))

    def facts(self) -> list[int]:
        facts = self.view.facts()
        assert facts is not None
        return facts


def no_columns(body: bytes) -> Columns:
    return ((0,), None)


def test_memory_of_another_kind_is_refused() -> None:
    for size in (0, 8, 4096, 4097, 100_000):
        with pytest.raises(InvalidArgument):
            RingView(memoryview(bytearray(size)))
    ring = Ring()
    for word, value in ((0, 1), (1, 2), (2, 3), (2, 0), (2, 16), (3, 2048), (3, -8)):
        memory = memoryview(bytearray(ring.memory))
        words_of(memory)[word] = value
        with pytest.raises(InvalidArgument):
            RingView(memory)


def test_a_ring_has_its_incarnation_state_and_fence() -> None:
    ring = Ring()
    assert ring.view.incarnation == 2**63 + 5
    assert not ring.view.is_open(BOOTTIME)
    ring.writer.set_fence(BOOTTIME + 1)
    assert ring.view.is_open(BOOTTIME)
    assert not ring.view.is_open(BOOTTIME + 1)
    ring.writer.set_fence(2**62)
    ring.writer.close()
    assert not ring.view.is_open(BOOTTIME)


def test_half_written_facts_of_a_stopped_host_are_ignored() -> None:
    ring = Ring()
    ring.put(1)
    words_of(ring.memory)[SEQUENCE_WORD] += 1
    assert ring.view.facts() is None


class WriterStopped(Exception):
    """The writer was killed or stopped here."""


class Stores:
    """Lets a writer make the given number of stores. If the last one stores bytes, it stores only half of them."""

    def __init__(self, memory: memoryview, left: list[int]) -> None:
        self._memory, self._left = memory, left

    def __getitem__(self, place: int) -> int:
        value: int = self._memory[place]
        return value

    def __setitem__(self, place: int | slice, value: int | bytes) -> None:
        if not self._left[0]:
            if isinstance(place, slice):
                half = len(value) // 2  # type: ignore[arg-type]
                self._memory[place.start : place.start + half] = value[:half]  # type: ignore[index]
            raise WriterStopped
        self._left[0] -= 1
        self._memory[place] = value  # type: ignore[assignment]


def body_of(seq: int) -> bytes:
    return b"%4d" % seq * 50  # the ring has room for fewer than 8 items, so it overwrites older ones


@pytest.mark.parametrize("before", [0, 3, 40])  # the ring is empty, has room, or overwrites
def test_a_reader_sees_the_old_items_the_new_items_or_none_wherever_the_writer_stops(before: int) -> None:
    for stores in range(100):
        ring, left = Ring(), [stores]
        for seq in range(1, before + 1):
            ring.put(seq, body_of(seq))
        ring.writer._words, ring.writer._data = (  # type: ignore[assignment]
            Stores(one, left) for one in (ring.writer._words, ring.writer._data)
        )
        try:
            ring.put(before + 1, body_of(before + 1))
        except WriterStopped:
            assert left == [0]
        else:
            break
        facts = ring.view.facts()
        if facts is None:
            continue  # the reader asks the host
        newest = find_newest(ring.view, facts)
        if isinstance(newest, FoundNewest):
            assert newest.slot.seq in (before, before + 1)
            assert newest.body == body_of(newest.slot.seq)
        for seq in range(max(1, before - 9), before + 2):
            found = find_next(ring.view, facts, seq, -1, 1000, no_columns)
            assert isinstance(found, bool) or found.piece.body == body_of(seq)
        interval = ReadQuery(Interval(Bound(None, before - 2), Bound(None, before + 1)))
        picked = select(ring.view, facts, interval, 1000, no_columns)
        bodies = [body_of(seq) for seq in range(before - 2, before + 2)]
        assert picked is None or [piece.body for piece in picked.pieces] in (bodies, bodies[:-1])
    assert 25 < stores < 60


def test_a_copy_of_overwritten_data_is_not_used() -> None:
    ring = Ring()
    for time in range(3):
        ring.put(time)
    facts = ring.facts()
    assert isinstance(find_newest(ring.view, facts), FoundNewest)
    for time in range(3, 30):
        ring.put(time)
    assert find_newest(ring.view, facts) is True
    assert find_next(ring.view, facts, 2, 0, 1000, no_columns) is True
    assert select(ring.view, facts, ReadQuery(Interval(Bound(None, 1), Bound(None, 2))), 1000, no_columns) is None


def test_the_writer_never_keeps_more_slots_or_bytes_than_the_ring_has() -> None:
    ring, drawn = Ring(), random.Random(1)
    for time in range(500):
        ring.put(time, bytes(drawn.randrange(1, 250)))
        facts = ring.facts()
        oldest, head = ring.view.oldest_slot(facts), facts[1]
        slots = [ring.view.slot(number) for number in range(oldest, head)]
        assert 1 <= len(slots) <= SIZE.slots
        assert [one.seq for one in slots] == [*range(time + 2 - len(slots), time + 2)]
        covered = [(one.offset % 1024, one.offset % 1024 + one.length) for one in slots]
        assert all(a >= d or b <= c for i, (a, b) in enumerate(covered) for c, d in covered[:i]), "runs overlap"


def test_damaged_numbers_cause_errors_or_a_read_at_the_host_but_no_access_outside_of_the_memory() -> None:
    drawn = random.Random(7)
    wild = (0, 1, -1, 7, 8, 2**31, 2**62, 2**63 - 1, -(2**63))
    for _ in range(3000):
        ring = Ring()
        for time in range(6):
            ring.put(time)
        words = words_of(ring.memory)
        for _ in range(drawn.randrange(1, 4)):
            place = drawn.choice((*range(5, 24), *range(HEADER_WORDS, HEADER_WORDS + 6 * SLOT_WORDS)))
            words[place] = drawn.choice((*wild, drawn.randrange(0, 2048)))
        facts = ring.view.facts()
        if facts is None:
            continue
        start = drawn.randrange(0, 7)
        query = ReadQuery(Interval(Bound(None, start), Bound(None, start + 2)), limit=drawn.choice((None, 1)))
        with suppress(StampedeError):
            find_newest(ring.view, facts)
            find_next(ring.view, facts, start, -1, 1000, no_columns)
            select(ring.view, facts, query, host_now(facts, BOOTTIME), no_columns)


def test_the_estimate_of_the_hosts_clock_advances_between_readings_and_corrects_its_offset() -> None:
    facts = [0] * 16
    facts[11:14] = BOOTTIME, 5000, 0
    assert host_now(facts, BOOTTIME) == 5000
    assert host_now(facts, BOOTTIME + 70) == 5070
    assert host_now(facts, BOOTTIME - 1) == 5000
    facts[13] = 30_000_000_000
    assert host_now(facts, BOOTTIME + 100) == 5150  # the estimate runs at most 1.5 times as fast as the boot time
    facts[13] = 30
    assert host_now(facts, BOOTTIME + 10**9) == 5000 + 10**9 + 1


def test_a_ring_has_at_least_the_wanted_room() -> None:
    for wanted in (1, 4096, 5000, 4 * 2**20, 64 * 2**20):
        size = ring_size(wanted)
        assert size.data_bytes >= wanted
        assert size.slots & (size.slots - 1) == 0
