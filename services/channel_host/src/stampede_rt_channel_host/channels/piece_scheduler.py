"""Long work of a host, such as a get of a million items, a piece at a time (decision 0061)."""

from __future__ import annotations

import asyncio
from typing import TypeVar

from stampede_rt_channel_host.core.channel import Pieces, Unfinished, abandoning, first_of

Result = TypeVar("Result")


class PieceScheduler:
    """Lets all long work of a host have its pieces in turn: one piece of one of them for each turn of the event loop,
    however many there are."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._begun: set[asyncio.Task[None]] = set()  # kept here, since the loop holds its tasks weakly

    async def do(self, pieces: Pieces[Result]) -> Result:
        """The result. The first piece, which nearly always is all, is done at once."""
        found = first_of(pieces)
        return await self.finish(found.rest) if isinstance(found, Unfinished) else found

    def begin(self, pieces: Pieces[None]) -> None:
        """Do the first piece at once, and the others in turn, which nobody waits for."""
        found = first_of(pieces)
        if isinstance(found, Unfinished):
            task = asyncio.create_task(self.finish(found.rest), name="long work")
            self._begun.add(task)
            task.add_done_callback(self._begun.discard)

    async def finish(self, pieces: Pieces[Result]) -> Result:
        """The result, once all pieces that are left are done. Raises what they raise; cancelled, it abandons them."""
        try:
            while True:  # ends with the pieces
                async with self._turn:
                    try:
                        next(pieces)
                    except StopIteration as end:
                        return end.value  # type: ignore[no-any-return]
                    await asyncio.sleep(0)
        except asyncio.CancelledError:
            self.begin(abandoning(pieces))
            raise
