"""Makes the pages of listings. A page has only the things that the caller may list.

The answer, and the token of the next page, depend only on these things. So a caller cannot find the names of other
things by small pages or by patterns.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.rpc import Context
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.queries import PAGE_SIZE_MAX
from stampede_rt_supernode.servicers.calls import DirectoryCalls, seconds_left

JUDGED_PER_TURN = 100
"""In one turn of the event loop, `list_shown` judges this many things at most: 0.1 ms each with a thousand rules."""

Record = TypeVar("Record")
Position = TypeVar("Position")


@dataclass(frozen=True, slots=True)
class SearchStep(Generic[Record, Position]):
    """One step of a search: matching things, each with its position in the order of the listing.

    The next step begins after `last`, which is None at the end of the listing.
    """

    found: Sequence[tuple[Position, Record]]
    last: Position | None


@dataclass(frozen=True, slots=True)
class ListedPage(Generic[Record, Position]):
    """The things on a page. The next page begins after `last`, which is None for the last page.

    The page includes all changes up to log position `applied_index`.
    """

    things: list[Record]
    last: Position | None
    applied_index: int


async def list_shown(
    calls: DirectoryCalls,
    context: Context,
    search: Callable[[Directory, Position, int], SearchStep[Record, Position]],
    is_shown: Callable[[Record], bool],
    after: Position,
    page_size: int,
    *,
    stale_ok: bool,
) -> ListedPage[Record, Position]:
    """At most `page_size` (0: PAGE_SIZE_MAX) things after the position `after` for which `is_shown` is true.

    `search` gets the directory, a position and a number, and returns at most that many matching things after the
    position. Raises Overloaded if the caller's time ends first. Raises also the errors of `search` and of
    `DirectoryCalls.read`.
    """
    limit, position = min(page_size or PAGE_SIZE_MAX, PAGE_SIZE_MAX), after
    until_s = time.monotonic() + seconds_left(context)
    shown: list[tuple[Position, Record]] = []

    def next_step(directory: Directory) -> tuple[SearchStep[Record, Position], int]:
        return search(directory, position, JUDGED_PER_TURN), directory.applied_index

    step, applied_index = await calls.read(context, next_step, stale_ok=stale_ok)
    while True:
        shown += ((at, thing) for at, thing in step.found if is_shown(thing))
        if len(shown) > limit:
            return ListedPage([thing for _, thing in shown[:limit]], shown[limit - 1][0], applied_index)
        if step.last is None:
            return ListedPage([thing for _, thing in shown], None, applied_index)
        if time.monotonic() > until_s:
            raise Overloaded("the listing takes longer than its caller waits; ask with a narrower pattern (name_glob)")
        position = step.last
        await asyncio.sleep(0)
        step, _ = await calls.read(context, next_step, stale_ok=True)
