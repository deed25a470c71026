"""The earlier items of a replayed subscription: the archive loses items, a read fails, and a caller stops waiting."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async import earlier_pages
from stampede_rt._async.earlier_pages import EarlierPages
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import ALL_TIME, Match

SEQS = [*range(1, 9)]


class Page(list[Any]):
    """An answer. `times` and `seqs` are equal."""

    def __init__(self, seqs: list[int], more: bool) -> None:
        super().__init__(SimpleNamespace(seq=seq, payload=b"x") for seq in seqs)
        self.times = self.seqs = seqs
        self.more, self.past, self.interval = more, None, None


class Archive:
    """Eight items, two in a page. Some have `gone`. The read with the number `fails_at` fails."""

    def __init__(self) -> None:
        self.gone: set[int] = set()
        self.fails_at = 0
        self.reads = 0

    async def read(self, query: ReadQuery, as_of: int) -> Any:
        await asyncio.sleep(0)
        self.reads += 1
        if self.reads == self.fails_at:
            raise st.Unavailable("the host is unreachable")
        start, end = query.interval.start.offset, query.interval.end.offset
        low = 0 if query.after is None else query.after.seq
        found = [seq for seq in SEQS if start <= seq <= end and seq > low and seq not in self.gone]
        return Page(found[: query.limit], more=query.limit is not None and len(found) > query.limit)


@pytest.fixture
def archive(monkeypatch: pytest.MonkeyPatch) -> Archive:
    for name, most in (("KEYS_PER_PAGE", 3), ("PAGE_ITEMS_FIRST", 2), ("PAGE_ITEMS_MAX", 2)):
        monkeypatch.setattr(earlier_pages, name, most)
    return Archive()


def pages_of(archive: Archive) -> EarlierPages:
    return EarlierPages("cam", archive.read, ReadQuery(ALL_TIME, match=Match.START), as_of=9)


async def rest_of(pages: EarlierPages) -> list[int]:
    found: list[int] = []
    while items := await pages.take():
        found += [item.seq for item in items]
    return found


@pytest.mark.asyncio
async def test_items_that_have_left_the_archive_do_not_hide_the_later_ones(archive: Archive) -> None:
    pages = pages_of(archive)
    await pages.begin()
    archive.gone = {1, 2, 3, 4, 6}
    assert await rest_of(pages) == [5, 7, 8]


@pytest.mark.parametrize("fails_at", range(1, 9))
@pytest.mark.asyncio
async def test_a_failed_read_neither_loses_nor_repeats_items(archive: Archive, fails_at: int) -> None:
    pages, found = pages_of(archive), list[int]()
    archive.fails_at = fails_at
    try:
        await pages.begin()
    except st.Unavailable:
        await pages.begin()
    for _ in range(5):
        try:
            found += [item.seq for item in await pages.take()]
        except st.Unavailable:
            continue
    assert found + await rest_of(pages) == SEQS


@pytest.mark.asyncio
async def test_a_caller_that_stops_waiting_loses_nothing(archive: Archive) -> None:
    pages = pages_of(archive)
    await pages.begin()
    step = asyncio.create_task(pages.take())
    await asyncio.sleep(0)
    step.cancel()
    await asyncio.wait([step])
    assert step.cancelled()
    assert await rest_of(pages) == SEQS


@pytest.mark.asyncio
async def test_late_items_come_in_the_order_of_acceptance_and_no_step_sorts_more_than_an_answer(
    archive: Archive, monkeypatch: pytest.MonkeyPatch
) -> None:
    accepted = {1: 5, 2: 1, 3: 2, 4: 8, 5: 7, 6: 3, 7: 4, 8: 6}  # the seq of the item of each time
    sizes: list[int] = []

    def sort(values: Any, **key: Any) -> list[Any]:
        found = sorted(values, **key)
        sizes.append(len(found))
        return found

    async def read(query: ReadQuery, as_of: int) -> Any:
        low = 0 if query.after is None else query.after.time
        start, end = query.interval.start.offset, query.interval.end.offset
        times = [time for time in accepted if start <= time <= end and time > low]
        page = Page([accepted[time] for time in times[: query.limit]], more=len(times) > (query.limit or 99))
        page.times = times[: query.limit]
        for item, time in zip(page, page.times, strict=True):
            item.time = time
        return page

    monkeypatch.setattr(earlier_pages, "sorted", sort, raising=False)
    pages = EarlierPages("cam", read, ReadQuery(ALL_TIME, match=Match.START), as_of=9)
    await pages.begin()
    assert await rest_of(pages) == SEQS
    assert max(sizes) == 3
