"""The check of a channel's history finds planted violations, and accepts histories without one."""

from __future__ import annotations

import pytest

from tests.robustness.histories.operations import Operation
from tests.robustness.histories.ownership_model import (
    AllItems,
    ItemStored,
    Newest,
    NewestSeq,
    Put,
    ReadAll,
    early_losses,
    judge_items,
)

A, B = 7, 8


def op(call: object, invoked: float, returned: float | None, answer: object = None) -> Operation:
    return Operation("cam", call, invoked, *(() if returned is None else (returned, answer)))  # type: ignore[arg-type]


def put(payload: bytes, invoked: float, incarnation: int, seq: int, *, took: float = 1.0) -> Operation:
    return op(Put(payload), invoked, invoked + took, ItemStored(incarnation, seq))


def newest(invoked: float, incarnation: int, seq: int) -> Operation:
    return op(Newest(), invoked, invoked + 1, NewestSeq(incarnation, seq))


def listed(invoked: float, incarnation: int, *items: tuple[int, bytes]) -> Operation:
    return op(ReadAll(), invoked, invoked + 1, AllItems(incarnation, items))


FIRST, SECOND = put(b"1", 0, A, 1), put(b"2", 2, A, 2)


@pytest.mark.parametrize(
    "history",
    [
        [],
        [FIRST, SECOND, newest(4, A, 2), listed(6, A, (1, b"1"), (2, b"2"))],
        # Two puts at the same time may be stored in either order.
        [put(b"1", 0, A, 2), put(b"2", 0, A, 1), newest(4, A, 2)],
        # The channel has a new owner. The former owner's items are gone. Readers learn this from the new incarnation.
        [FIRST, put(b"2", 2, B, 1), newest(4, B, 1), listed(6, B, (1, b"2"))],
        # A new owner without an item yet.
        [FIRST, newest(2, B, 0), put(b"2", 4, B, 1)],
        # A put without an answer: the host has stored its item, or not.
        [FIRST, op(Put(b"2"), 2, None), newest(4, A, 2), listed(6, A, (1, b"1"), (2, b"2"))],
        [FIRST, op(Put(b"2"), 2, None), newest(4, A, 1)],
        # The former owner stored an item before the new owner stored any, and its answer came late.
        [FIRST, put(b"2", 2, A, 2, took=5), put(b"3", 4, B, 1)],
    ],
)
def test_a_history_with_one_owner_at_a_time_is_accepted(history: list[Operation]) -> None:
    judged = judge_items(history)
    assert judged.violations == ()
    assert (judged.lost, judged.doubled) == (0, 0)


@pytest.mark.parametrize(
    ("history", "complaint"),
    [
        # The former owner takes an item after the new owner has taken one.
        ([FIRST, put(b"2", 2, B, 1), put(b"3", 4, A, 2)], "no order of these operations"),
        # The former owner answers a reader after the new owner has taken an item.
        ([FIRST, put(b"2", 2, B, 1), newest(4, A, 1)], "no order of these operations"),
        # Two items with one seq.
        ([FIRST, put(b"2", 2, A, 1)], "no order of these operations"),
        # A reader gets an item as the newest one after a later item was acknowledged.
        ([FIRST, SECOND, newest(4, A, 1)], "no order of these operations"),
        # An acknowledged item is lost, though its owner is still there and has newer items.
        ([FIRST, SECOND, listed(4, A, (2, b"2"))], "b'1' was acknowledged or seen, and is lost"),
        # An item that no host has acknowledged, but that a reader has got, is lost.
        (
            [FIRST, op(Put(b"2"), 2, None), listed(4, A, (1, b"1"), (2, b"2")), listed(6, A, (1, b"1"), (3, b"3"))],
            "b'2' was acknowledged or seen, and is lost",
        ),
        # A put that was tried again was stored twice.
        ([FIRST, SECOND, listed(4, A, (1, b"1"), (2, b"2"), (3, b"2"))], "b'2' was stored twice"),
        # A reader gets an item that no caller has put.
        ([FIRST, put(b"2", 2, B, 1), listed(4, B, (1, b"2"), (2, b"forged"))], "no caller put b'forged'"),
    ],
)
def test_a_planted_violation_is_found(history: list[Operation], complaint: str) -> None:
    assert any(complaint in violation for violation in judge_items(history).violations)


def test_items_in_the_memory_of_a_dead_host_are_not_counted_as_lost() -> None:
    judged = judge_items([FIRST, SECOND, put(b"3", 4, B, 1)])
    assert (judged.channels, judged.acknowledged, judged.gone_with_host, judged.lost) == (1, 3, 2, 0)


def test_items_that_a_replica_still_has_are_not_lost() -> None:
    late = put(b"3", 8, A, 3)
    continued = [FIRST, SECOND, late, put(b"4", 10, A + 1, 3), listed(12, A + 1, (1, b"1"), (2, b"2"), (3, b"4"))]
    assert (judge_items(continued).gone_with_host, early_losses(continued)) == (1, [])
    lacks_more = [*continued[:-1], listed(12, A + 1, (1, b"1"), (3, b"4"))]
    assert judge_items(lacks_more).gone_with_host == 2
    assert "1 items were lost" in early_losses(lacks_more)[0]
    assert early_losses(lacks_more[:-1]) == [], "no reader has read the items that exist"
    shown = listed(8, A, (1, b"1"), (2, b"2"), (3, b"3"))  # the owner showed item 3, and did not acknowledge it
    lost = [FIRST, SECOND, shown, put(b"4", 10, A + 1, 2), listed(12, A + 1, (1, b"1"), (2, b"4"))]
    assert early_losses(lost) == [], "item 2 was one of the last second"


def test_an_item_that_was_read_but_not_acknowledged_may_be_lost_with_its_host() -> None:
    unanswered = op(Put(b"2"), 2, None)
    judged = judge_items([FIRST, unanswered, listed(4, A, (1, b"1"), (2, b"2")), put(b"3", 6, B, 1)])
    assert (judged.acknowledged, judged.gone_with_host) == (2, 2)
