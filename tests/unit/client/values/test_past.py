"""The past cut of a group, computed from the newest time and the advance of each member."""

from __future__ import annotations

import pytest

from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import NewestItems
from stampede_rt.values.model import Reason
from stampede_rt.values.past import PastMark, add_reason, past_cut_of
from stampede_rt.values.timeline import MIN_INSTANT

GONE = Reason("COLLECTED", "the archive has dropped them")


def mark(
    newest: int | None, advance: int | None = None, reason: Reason | None = None, change: int | None = None
) -> PastMark:
    return PastMark("cam", newest, advance, reason, change)


def answer(reason: Reason | None = None, *, complete: bool = False) -> Items:
    return Items([], interval=None, complete=complete, truncated=False, more=False, reason=reason, incarnation=1)


def test_the_cut_is_the_least_of_the_later_times_and_advances() -> None:
    assert past_cut_of([mark(5, 9), mark(7), mark(None, 8)]) == (7, None, None)
    assert past_cut_of([mark(5), mark(None)]).cut == MIN_INSTANT
    assert past_cut_of([mark(5, change=12), mark(6, change=10), mark(7)]).next_change == 10


def test_missing_items_count_only_if_they_decide_the_cut() -> None:
    assert past_cut_of([mark(5), mark(7, reason=GONE)]) == (5, None, None)
    assert past_cut_of([mark(7), mark(7, reason=GONE)]).reason is None
    assert past_cut_of([mark(None), mark(None, reason=GONE)]) == (MIN_INSTANT, None, None)
    decided = past_cut_of([mark(7), mark(6, reason=GONE)])
    assert (decided.cut, decided.reason) == (6, "COLLECTED")
    assert decided.reason is not None
    assert "cam held back the earlier cut" in decided.reason.detail
    assert past_cut_of([mark(7), mark(None, reason=GONE)])[:2] == (MIN_INSTANT, "COLLECTED")


@pytest.mark.parametrize(
    ("items", "reason"),
    [
        (answer(Reason.HIDDEN), "COLLECTED"),
        (answer(Reason.NOT_YET), "COLLECTED"),
        (answer(), "COLLECTED"),
        (answer(complete=True), None),
        (answer(Reason.LOST), "LOST"),
    ],
)
def test_an_answer_reports_an_uncertain_cut_unless_its_interval_ends_before_the_cut(
    items: Items, reason: str | None
) -> None:
    assert add_reason(items, GONE).reason == reason
    assert NewestItems([], {b"": items}, GONE).reasons._values == ({} if reason is None else {b"": reason})


def test_an_exact_cut_does_not_change_the_reason() -> None:
    assert add_reason(answer(Reason.HIDDEN), None).reason == "HIDDEN"
