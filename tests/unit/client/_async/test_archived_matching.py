"""Matches of the past: the times of items that wait take a bounded memory, and equal times do not cost a read each."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async import archived_matching
from stampede_rt._async.archived_matching import ArchivedMatching, ArchivedMember
from stampede_rt.matching.item_keys import ItemKey
from stampede_rt.values.answers import Items, PastState
from stampede_rt.values.match_rule import MatchRule
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import OLDEST

GROUP: Any = SimpleNamespace(name="g", idle_after_nanos=None)


class Archive:
    """The archived items of one channel, with these times. `reads`: how many items each read returned."""

    def __init__(self, times: Sequence[int]) -> None:
        self.items = [Item(time, None, None, seq, b"x", {}, "", 0, 7) for seq, time in enumerate(times, 1)]
        self.reads: list[int] = []

    async def read(self, query: ReadQuery, as_of: int) -> Items:
        await asyncio.sleep(0)
        found = self.items
        if query.interval.start.meta is None:
            found = [one for one in found if query.interval.start.offset <= one.time <= query.interval.end.offset]
        if isinstance(query.after, Item):
            after = query.after.time, query.after.seq
            found = [one for one in found if (one.time, one.seq) > after]
        found = found[::-1] if query.newest_first else found
        page = found[: query.limit]
        self.reads.append(len(page))
        return Items(
            page, interval=None, complete=True, truncated=False, more=len(page) < len(found), reason=None,
            incarnation=7, past=PastState(None, None, None),
        )  # fmt: skip


def member(name: str, archive: Archive) -> ArchivedMember:
    handle: Any = SimpleNamespace(info=SimpleNamespace(channel_id=name.encode()), name=name)
    return ArchivedMember(handle, archive.read)


def matching_of(*archives: Archive) -> ArchivedMatching:
    members = [member(f"c{at}", archive) for at, archive in enumerate(archives)]
    return ArchivedMatching(
        GROUP,
        members,
        members[0],
        MatchRule.parse("0s", "0s", unique=False, partial=False, payloads=True, start=OLDEST),
    )


@pytest.mark.asyncio
async def test_a_repeated_step_without_room_takes_no_further_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(archived_matching, "KEYS_PER_PAGE", 4)
    monkeypatch.setattr(archived_matching, "KEYS_MAX", 10)
    fast, slow = Archive([*range(100)]), Archive([*range(100)])
    matching = matching_of(fast, slow)
    await matching.begin(1000)
    held = []
    for _ in range(5):
        with pytest.raises(st.Overloaded, match="more than 10 items"):
            await matching.load_all()
        held.append(len(matching._matcher))
    assert held[0] <= 10 + 4
    assert held == held[:1] * 5
    monkeypatch.setattr(archived_matching, "KEYS_MAX", 2**18)
    found = [await matching.next_match() for _ in range(100)]
    assert [one and one.key[0] for one in found] == [*range(100)]


@pytest.mark.asyncio
async def test_many_items_of_one_time_are_fetched_in_few_reads_that_return_few_items() -> None:
    archive = Archive([5] * 200)
    one = member("cam", archive)
    keys: list[ItemKey] = [(5, seq) for seq in range(1, 201)]
    items = [await one.item(key, 9, payloads=True) for key in keys]
    assert [item and (item.time, item.seq) for item in items] == keys
    assert len(archive.reads) == 13
    assert sum(archive.reads) == 200
    assert await one.item((5, 201), 9, payloads=True) is None
