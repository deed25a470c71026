"""Things that are due in order."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_channel_host.core.deadlines import Deadlines


@dataclass(eq=False)
class Thing:
    order: int
    due: int | None = None


def test_things_are_due_in_order_and_only_at_their_last_deadline() -> None:
    deadlines, one, two, three = Deadlines[Thing](), Thing(1), Thing(2), Thing(3)
    deadlines.arm(one, 5)
    deadlines.arm(two, 5)
    deadlines.arm(three, 1)
    deadlines.arm(three, 9)
    assert (deadlines.next(), deadlines.pop(4)) == (5, None)
    assert [deadlines.pop(9) for _ in range(4)] == [one, two, three, None]
    assert deadlines.next() is None


def test_what_is_disarmed_is_not_due() -> None:
    deadlines, one = Deadlines[Thing](), Thing(1)
    deadlines.arm(one, 5)
    deadlines.disarm(one)
    deadlines.disarm(one)
    assert deadlines.pop(10) is None


def test_a_deadline_that_is_put_off_again_and_again_takes_no_more_room() -> None:
    deadlines, one = Deadlines[Thing](), Thing(1)
    for due in range(10_000):
        deadlines.arm(one, due)
    assert len(deadlines._heap) < 200
    assert deadlines.pop(9_999) is one
