"""One answer that a host gives in several pages, because it reads a long part of an archive. Pure."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.values.answers import Items
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import MetaTime, fixed


class Pages:
    """The pages of the answer to `query`. The host resolved the interval of the query with the first page."""

    def __init__(self, query: ReadQuery, first: Items) -> None:
        self._query = query
        self._pages = [first]

    @property
    def rest(self) -> ReadQuery:
        """The query of the next page: the items after the items of the earlier pages, as many as the limit leaves.

        Through a group, this query reads at the cut of the first page.
        """
        first = self._pages[0]
        left = None if self._query.limit is None else self._query.limit - sum(map(len, self._pages))
        last = next(page for page in reversed(self._pages) if page)[-1]
        interval, cut = fixed(self._query.interval, first.interval), self._query.cut
        cut = first.cut if cut is None else cut
        return replace(self._query, interval=interval, after=last, limit=left, cut=cut, now=self._now)

    @property
    def _now(self) -> int | None:
        """The instant NOW of the first page, if the interval ends relative to it."""
        end, within = self._query.interval.end, self._pages[0].interval
        return within.end - end.offset if within is not None and end.meta is MetaTime.NOW else None

    def add(self, page: Items) -> None:
        """Take the next page."""
        self._pages.append(page)

    @property
    def whole(self) -> Items:
        """All pages as one answer."""
        first, last = self._pages[0], self._pages[-1]
        if first is last:
            return first
        items: list[Item] = [item for page in self._pages for item in page]
        # the archive may have dropped items since the first page
        truncated = any(page.truncated for page in self._pages)
        return Items(
            items,
            interval=first.interval,
            complete=first.complete,
            truncated=truncated,
            more=last.more,
            reason=self._first_reason("LOST") or self._reason(first, last, truncated=truncated),
            incarnation=first.incarnation,
            cut=first.cut,
            staleness_nanos=first.staleness_nanos,
            past=first.past,
        )

    def _reason(self, first: Items, last: Items, *, truncated: bool) -> Reason | None:
        if self._query.newest_first and truncated and not last.more:
            return last.reason  # the last page has the earliest items
        hidden = last.reason if last.reason == "HIDDEN" else None  # the last page reaches the cut
        collected = None if self._query.newest_first else self._first_reason("COLLECTED")
        return first.reason or collected or hidden

    def _first_reason(self, value: str) -> Reason | None:
        return next((page.reason for page in self._pages if page.reason == value), None)
