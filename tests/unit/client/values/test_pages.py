"""One answer in several pages, during which the archive drops items."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.values.answers import Items
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.pages import Pages
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import ALL_TIME, NOW, Bound, Interval, Match, ResolvedInterval

GONE, LOST = Reason("COLLECTED", "the archive has dropped them"), Reason("LOST", "a block is damaged")


def page(*times: int, reason: Reason | None = None, truncated: bool = False, more: bool = True) -> Items:
    items = [Item(time, None, None, time, b"", {}, "", 0, 1) for time in times]
    return Items(
        items, interval=None, complete=True, truncated=truncated, more=more, reason=reason, incarnation=1
    )  # fmt: skip


def joined(*pages: Items, newest_first: bool = False) -> Items:
    whole = Pages(ReadQuery(ALL_TIME, newest_first=newest_first), pages[0])
    for one in pages[1:]:
        whole.add(one)
    return whole.whole


@pytest.mark.parametrize("newest_first", [False, True])
def test_items_that_the_archive_drops_after_the_first_page_have_a_reason(newest_first: bool) -> None:
    pages = [page(1, 2), page(7, 8, reason=GONE, truncated=True, more=False)]
    whole = joined(*pages, newest_first=newest_first)
    assert (len(whole), whole.reason, whole.truncated) == (4, "COLLECTED", True)
    empty = joined(page(1, 2), page(reason=GONE, truncated=True, more=False), newest_first=newest_first)
    assert (len(empty), empty.reason, empty.truncated) == (2, "COLLECTED", True)


def test_the_reasons_of_the_pages_become_one_reason() -> None:
    assert joined(page(1), page(2), page(3, more=False)).reason is None
    assert joined(page(1), page(reason=Reason("NEVER"), more=False)).reason is None
    assert joined(page(1), page(2, reason=GONE, truncated=True), page(3, reason=LOST)).reason == "LOST"
    assert joined(page(1), page(2, reason=Reason("HIDDEN"), more=False)).reason == "HIDDEN"
    limited = joined(page(9, truncated=True), page(8, truncated=True), newest_first=True)
    assert (limited.reason, limited.truncated, limited.more) == (None, True, True)


def test_a_later_page_has_the_instant_now_of_the_first_page() -> None:
    """Otherwise match="whole" left out a newest item without a duration, because its span then lasted longer."""
    first = page(1, 2)
    first.interval = ResolvedInterval(0, 95)
    at_now = Interval(Bound(None, 0), replace(NOW, offset=-5))
    rest = Pages(ReadQuery(at_now, match=Match.WHOLE), first).rest
    assert (rest.now, rest.interval.end.offset) == (100, 95)
    assert Pages(ReadQuery(Interval(Bound(None, 0), Bound(None, 95))), first).rest.now is None
