"""Performs the long work of a host, such as a get of a million items, in pieces (decision 0061)."""

from __future__ import annotations

import asyncio
from typing import TypeVar

from stampede_rt_channel_host.core.channel import Pieces, UnfinishedWork, abandoning, first_of
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.quotas.accounts import unlimited
from stampede_rt_runtime.quotas.working import CallerWork

Result = TypeVar("Result")


class PieceScheduler:
    """Performs the long work of a host, piece by piece.

    It performs at most one piece in each turn of the event loop, however much work there is. The first pieces, which
    `do` and `begin` perform in the call itself, come in addition.
    """

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        # kept here, because the loop keeps only weak references to its tasks
        self._tasks: set[asyncio.Task[None]] = set()

    async def do(self, pieces: Pieces[Result]) -> Result:
        """Perform the work, and return its result. Performs the first piece without a wait; most work has only one."""
        found = first_of(pieces)
        return await self.finish(found.rest) if isinstance(found, UnfinishedWork) else found

    def begin(self, pieces: Pieces[None]) -> None:
        """Perform the first piece in this call, and the other pieces in later turns. Does not wait for them."""
        found = first_of(pieces)
        if isinstance(found, UnfinishedWork):
            task = asyncio.create_task(self._finish(found.rest, CallerWork(unlimited())), name="long work")
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def finish(self, pieces: Pieces[Result]) -> Result:
        """Perform the remaining pieces, each when the caller has its turn, and return the result.

        Raises the errors of the pieces. After a cancellation, only frees the memory of the remaining pieces, in pieces.
        """
        return await self._finish(pieces, current_work())

    async def _finish(self, pieces: Pieces[Result], work: CallerWork) -> Result:
        try:
            while True:  # ends with the last piece
                if work.must_wait:
                    await work.turn()
                async with self._turn:
                    try:
                        next(pieces)
                    except StopIteration as end:
                        return end.value  # type: ignore[no-any-return]
                    await asyncio.sleep(0)
        except asyncio.CancelledError:
            self.begin(abandoning(pieces))
            raise
