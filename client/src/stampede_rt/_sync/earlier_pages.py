# Generated from ../_async by tools/generate.py; do not edit.
"""The items that a recorded channel had at an instant, in the order of their acceptance, a few at a time."""

from __future__ import annotations

import heapq
from array import array
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

from stampede_rt.errors import IncarnationLost, Overloaded
from stampede_rt.values.answers import Items, PastState
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import Match, fixed, parse_interval

ReadAsOf = Callable[[ReadQuery, int], Items]

KEYS_MAX = 2**20
"""The most items. For each the reader holds its time, its seq and its place: 20 MB at most."""
KEYS_PER_PAGE = 2**13
PAGE_BYTES = 4 * 2**20
PAGE_ITEMS_FIRST, PAGE_ITEMS_MAX = 16, 1024


class EarlierPages:
    """The items of `query` as of an instant. Holds their keys, and one page of items.

    The items of a page are neighbours in time, so that the interval of a read has no other items. One step sorts
    at most the keys of one answer of the host: a sort of 2^20 keys would block an event loop for half a second.
    """

    def __init__(
        self, name: str, read_as_of: ReadAsOf, query: ReadQuery, as_of: int, after: Item | None = None
    ) -> None:
        """`after`: only the items that the host accepted after this one."""
        self._accepted_after = after
        self._name, self._read_as_of, self._query, self._as_of = name, read_as_of, query, as_of
        self._times, self._seqs = array("q"), array("Q")  # in the order of time
        self._order: Iterator[int] = iter(())  # places in these columns, in the order of acceptance
        self._ahead: list[int] = []  # the next of these places
        self._page_items = PAGE_ITEMS_FIRST

    def begin(self) -> PastState | None:
        """Find the items. Returns the facts about the channel at that instant. Raises Overloaded beyond KEYS_MAX.

        If the last call failed or was cancelled, this call begins anew.
        """
        del self._times[:], self._seqs[:], self._ahead[:]
        sorted_pages: list[array[int]] = []
        query = replace(self._query, payloads=False, limit=KEYS_PER_PAGE)
        while True:
            page, begin = self._read_as_of(query, self._as_of), len(self._seqs)
            self._keep(page)
            sorted_pages.append(array("I", sorted(range(begin, len(self._seqs)), key=self._seqs.__getitem__)))
            if len(self._times) > KEYS_MAX:
                raise Overloaded(
                    f"channel {self._name!r} had more than {KEYS_MAX} items after the start of the subscription "
                    "when the replay began; subscribe with a later start=, or replay from an earlier instant"
                )
            if not page.more:
                self._order = heapq.merge(*sorted_pages, key=self._seqs.__getitem__)
                return page.past
            query = replace(query, interval=fixed(query.interval, page.interval), after=page[-1])

    def _keep(self, page: Items) -> None:
        after = self._accepted_after
        if after is not None and page.incarnation != after.incarnation:
            raise IncarnationLost(
                f"channel {self._name!r} is incarnation {page.incarnation:x}, and the item given as after= is of "
                f"incarnation {after.incarnation:x}; subscribe with start="
            )
        low = 0 if after is None else after.seq + 1
        kept = [(time, seq) for time, seq in zip(page.times, page.seqs, strict=True) if seq >= low]
        self._times.extend(time for time, _ in kept)
        self._seqs.extend(seq for _, seq in kept)

    def take(self) -> list[Item]:
        """Return the next items; none after the last one. Leaves out items that the archive no longer has.

        If a call fails or is cancelled, the next call returns the same items.
        """
        while places := self._next_places():
            items = self._page(places)
            del self._ahead[: len(places)]
            if items:
                return items
        return []

    def _page(self, places: list[int]) -> list[Item]:
        window = parse_interval(self._times[places[0]], self._times[places[-1]])
        query = ReadQuery(window, match=Match.START, payloads=self._query.payloads)
        wanted = {self._seqs[place] for place in places}
        found = self._read_as_of(query, self._as_of)
        items = [one for one in found if one.seq in wanted]
        mean_bytes = 1 + sum(len(one.payload or b"") for one in items) // max(1, len(items))
        self._page_items = max(1, min(PAGE_ITEMS_MAX, PAGE_BYTES // mean_bytes))
        return sorted(items, key=lambda one: one.seq)

    def _next_places(self) -> list[int]:
        """The places of the next items, up to the first one that is not the neighbour of the item before it."""
        ahead, end = self._ahead, 1
        ahead.extend(islice(self._order, max(0, self._page_items - len(ahead))))
        while end < min(len(ahead), self._page_items) and ahead[end] == ahead[end - 1] + 1:
            end += 1
        return ahead[:end]
