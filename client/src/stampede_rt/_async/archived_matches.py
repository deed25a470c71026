"""Iterators over the matches of a group that come from archives."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from stampede_rt._async.archived_matching import ArchivedMatching
from stampede_rt._async.reader import Reader
from stampede_rt.handles import BoundToProcess
from stampede_rt.matching.key_matcher import KeyMatch
from stampede_rt.transports.concurrency_async import StepLock
from stampede_rt.values.grouping import Matched
from stampede_rt.values.model import Reason

Key = TypeVar("Key", bound=Reader)


class ArchivedMatches(BoundToProcess, Generic[Key]):
    """An iterator over `Matched` items (see `Group.match`), and a context manager. The iteration ends with the last
    match.

    `unmatched` and `dropped` count as in a `MatchSubscription`. `reason` is COLLECTED or LOST if the archive of a
    member has dropped or lost items. Some matches may then be missing, or may differ from the matches that a live
    reader got. `reason` is None if nothing is missing. A step raises Overloaded if too many items wait for a match.
    """

    def __init__(self) -> None:
        self._matching: ArchivedMatching | None = None
        self._found: KeyMatch | None = None  # the match whose items come next
        self._ready: Matched[Key] | None = None
        self._steps = StepLock()  # callers that step at the same time take turns
        self._closed = False
        self.losses = 0
        self.reconnects = 0

    @property
    def unmatched(self) -> int:
        """The number of items of `per` that had no partner in a member."""
        return 0 if self._matching is None else self._matching.unmatched

    @property
    def dropped(self) -> int:
        """The number of items that left the archive before this client fetched them, or came too late for a match."""
        return 0 if self._matching is None else self._matching.dropped

    @property
    def reason(self) -> Reason | None:
        """Why matches may be missing, or differ from the matches of a live reader; None: nothing is missing."""
        return None if self._matching is None else self._matching.reason

    @property
    def connected(self) -> bool:
        """Whether the iteration may continue."""
        return self._matching is not None and not self._closed

    async def __aenter__(self) -> Self:
        async with self._steps:
            await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Matched[Key]:
        async with self._steps:
            await self._open()
            while not self._closed:
                if self._ready is None:
                    self._ready = await self._next()
                if self._ready is None:
                    break
                await self._reach()
                matched, self._ready = self._ready, None  # only after the wait, because a caller may cancel it
                return matched
            raise StopAsyncIteration

    def close(self) -> None:
        """End the iteration."""
        self._closed = True

    async def _open(self) -> None:
        if self._matching is None and not self._closed:
            self._matching = await self._begin()

    async def _next(self) -> Matched[Key] | None:
        """Return the next match that the reader wants; None at the end."""
        matching = self._matching
        while matching is not None and not self._closed:
            self._found = self._found or await matching.next_match()
            if self._found is not None:
                matched: Matched[Any] | None = await matching.matched(self._found)
                self._found = None
                if matched is not None and matching.wants(matched):
                    return matched
            elif not await self._take_next_change(matching):
                break
        return None

    async def _begin(self) -> ArchivedMatching:
        """Begin to match."""
        raise NotImplementedError

    async def _take_next_change(self, matching: ArchivedMatching) -> bool:
        """Take later items into account. Returns False if there are none."""
        return False

    async def _reach(self) -> None:
        """Wait for the instant of the next match."""
