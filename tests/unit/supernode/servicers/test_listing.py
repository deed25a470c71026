"""Listings contain only things that their caller may list, and reveal nothing about the rest."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.servicers import listing
from stampede_rt_supernode.servicers.listing import ListedPage, SearchStep, list_shown

NAMES = [f"{kind}/{number:04}" for kind in ("a", "hidden", "z") for number in range(250)]


class Calls:
    """The calls of a supernode, with a count of the reads."""

    reads = confirmed = 0

    async def read(self, context: Any, query: Any, *, stale_ok: bool = False) -> Any:
        self.reads += 1
        self.confirmed += not stale_ok
        return query(SimpleNamespace(applied_index=self.reads))


def search(_: Directory, after: str, most: int) -> SearchStep[str, str]:
    later = [name for name in NAMES if name > after]
    return SearchStep([(name, name) for name in later[:most]], later[most - 1] if len(later) > most else None)


async def listed(after: str, size: int, calls: Any = None, seconds: float = 5.0) -> ListedPage[str, str]:
    context: Any = SimpleNamespace(time_remaining=lambda: seconds)
    return await list_shown(
        calls or Calls(), context, search, lambda name: not name.startswith("hidden"), after, size, stale_ok=False
    )


@pytest.mark.parametrize("size", [1, 99, 250, 499, 500, 0])
async def test_pages_of_every_size_have_each_visible_thing_once_and_tokens_name_only_visible_things(size: int) -> None:
    """In an earlier version, the token held the last name that the listing had read.

    A caller that asked for pages of one thing learned all hidden names.
    """
    got: list[str] = []
    after: str | None = ""
    while after is not None:
        page = await listed(after, size)
        assert len(page.things) == min(size or 1000, 500 - len(got)), "only the last page is short"
        got += page.things
        assert page.last in (None, got[-1])
        after = page.last
    assert got == [name for name in NAMES if not name.startswith("hidden")]


async def test_a_page_needs_one_confirmed_read_and_is_of_one_log_position() -> None:
    calls = Calls()
    page = await listed("", 0, calls)
    assert (calls.confirmed, page.applied_index) == (1, 1), (
        "the position is the first one, because later changes come by a watch"
    )
    assert calls.reads == len(NAMES) / listing.JUDGED_PER_TURN + 0.5


async def test_a_listing_ends_at_the_deadline_of_its_caller() -> None:
    with pytest.raises(Overloaded, match="narrower pattern"):
        await listed("", 0, seconds=0.0)
