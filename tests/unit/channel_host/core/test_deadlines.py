"""Things that are due in order."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from stampede_rt_channel_host.core.deadlines import EMPTIED_PER_PIECE, OUTDATED_PER_CALL_MAX, Deadlines


@dataclass(eq=False)
class Thing:
    order: int
    due: int | None = None


def test_things_are_due_in_order_and_only_at_their_last_deadline() -> None:
    deadlines, one, two, three = Deadlines[Thing](), Thing(1), Thing(2), Thing(3)
    deadlines.set_due(one, 5)
    deadlines.set_due(two, 5)
    deadlines.set_due(three, 1)
    deadlines.set_due(three, 9)
    assert (deadlines.next(), deadlines.pop(4)) == (5, None)
    assert [deadlines.pop(9) for _ in range(4)] == [one, two, three, None]
    assert deadlines.next() is None


def test_a_disarmed_deadline_is_not_due() -> None:
    deadlines, one = Deadlines[Thing](), Thing(1)
    deadlines.set_due(one, 5)
    deadlines.disarm(one)
    deadlines.disarm(one)
    assert deadlines.pop(10) is None


def test_a_deadline_that_is_extended_repeatedly_takes_no_more_room() -> None:
    deadlines, one = Deadlines[Thing](), Thing(1)
    for due in range(10_000):
        deadlines.set_due(one, due)
    assert len(deadlines._heap) + len(deadlines._old) < 200
    assert deadlines.pop(9_999) is one


class WatchedEntry:
    """Counts how often its deadline is read, in `reads`."""

    reads = 0

    def __init__(self, order: int) -> None:
        self.order = order
        self._due: int | None = None

    @property
    def due(self) -> int | None:
        WatchedEntry.reads += 1
        return self._due

    @due.setter
    def due(self, due: int | None) -> None:
        self._due = due


def test_no_call_looks_at_all_deadlines_though_nearly_all_of_them_are_outdated() -> None:
    deadlines = Deadlines[WatchedEntry]()
    things = [WatchedEntry(order) for order in range(10_000)]
    for thing in things:
        deadlines.set_due(thing, 10**6 + thing.order)
    for thing in things[1:]:
        deadlines.disarm(thing)
    for due in range(10_000):
        WatchedEntry.reads = 0
        deadlines.set_due(things[-1], 10**7 - due)
        assert WatchedEntry.reads < 50
    assert len(deadlines._heap) + len(deadlines._old) < 200
    assert [deadlines.pop(10**8) for _ in range(3)] == [things[0], things[-1], None]


def test_a_call_removes_a_bounded_number_of_outdated_entries_and_misses_no_deadline() -> None:
    deadlines, things, last = Deadlines[Thing](), [Thing(order) for order in range(1500)], Thing(2000)
    for thing in things:
        deadlines.set_due(thing, 5)
    deadlines.set_due(last, 7)
    for thing in things:
        deadlines.disarm(thing)
    lengths = [len(deadlines._heap)]
    while (due := deadlines.pop(9)) is None:
        lengths.append(len(deadlines._heap))
        assert (deadlines.next() or 9) <= 7
    assert due is last
    assert max(before - after for before, after in pairwise(lengths)) <= 2 * OUTDATED_PER_CALL_MAX


def test_many_entries_are_freed_in_pieces() -> None:
    deadlines = Deadlines[Thing]()
    for order in range(3 * EMPTIED_PER_PIECE):
        deadlines.set_due(Thing(order), order)
    left = [len(deadlines._heap) for _ in deadlines.emptying()]
    assert left == [2 * EMPTIED_PER_PIECE, EMPTIED_PER_PIECE, 0]
