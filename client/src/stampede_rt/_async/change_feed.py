"""The changes of a recorded channel after an instant, for a replay."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

from stampede_rt.values.answers import Items, PastState
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import ALL_TIME, Match, parse_interval

NEWEST_QUERY = ReadQuery(ALL_TIME, match=Match.START, limit=1, newest_first=True)


class PastSource(Protocol):
    """A channel that answers as of an instant. `end`: the instant at which its replay ends."""

    @property
    def name(self) -> str:
        """The channel's name."""

    @property
    def end(self) -> int:
        """The instant at which the replay ends."""

    async def read_as_of(self, query: ReadQuery, as_of: int) -> Items:
        """Return the answer as of an instant."""


class ChangeFeed:
    """The changes of a channel after an instant, one after the other, in the order of their acceptance."""

    def __init__(self, channel: PastSource, past: PastState | None, *, payloads: bool) -> None:
        self.channel = channel
        self._past = past
        self._payloads = payloads

    @property
    def next_change(self) -> int | None:
        """The instant of the next change; None if no change follows in the replay."""
        following = None if self._past is None else self._past.next_change
        return following if following is not None and following <= self.channel.end else None

    @property
    def advance(self) -> int | None:
        """The highest advance as of the last change."""
        return None if self._past is None else self._past.advance

    async def take(self) -> list[Item]:
        """Return the items of the next change, in the order of their seqs; none if it is an advance."""
        instant = self.next_change
        assert instant is not None, "the caller has read next_change before"
        found = None if self._past is None else self._past.next_items
        if found is None:
            items = await self.channel.read_as_of(replace(NEWEST_QUERY, payloads=False), instant)
            self._past = items.past
            return []
        first_seq, start, end = found
        query = ReadQuery(parse_interval(start, end), match=Match.START, payloads=self._payloads)
        items = await self.channel.read_as_of(query, instant)
        self._past = items.past
        return sorted((one for one in items if one.seq >= first_seq), key=lambda one: one.seq)
