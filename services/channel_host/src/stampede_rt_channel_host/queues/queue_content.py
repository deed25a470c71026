"""The content of a queue that has come from another host, and the state of a move of a queue to another host."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from stampede_rt.errors import Overloaded, StampedeError
from stampede_rt_channel_host.channels.move_under_way import HELD_SECONDS_MAX
from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.core.queue import QueueCore, QueueJournal


class QueueContent(NamedTuple):
    """A queue that has come from another host. `journal`: its steps; None: the former owner had no replicas.

    `is_replicated`: the replicas in sync have all its steps.
    """

    core: QueueCore
    journal: QueueJournal | None = None
    is_replicated: bool = True

    def emptying(self) -> Pieces[None]:
        """Free the memory, in pieces, because this host does not serve the queue."""
        if self.journal is not None:
            yield from self.journal.stopping()
        yield from self.core.emptying()


class KeptQueue(NamedTuple):
    """The replica that the former owner of a queue becomes: the queue itself, as it was held.

    `held_nanos`: the time of the hold, by a steady clock. From then on, its leases do not count the time.
    """

    core: QueueCore
    next_step: int
    held_nanos: int


class QueueMove:
    """A move of a queue to another host. `redirect_error`: the error that sends callers there after the move.

    `kept`: the queue becomes this replica if it moves; None: it has no replicas, or has not been handed over.
    """

    def __init__(self) -> None:
        self.is_held = False
        self.kept: KeptQueue | None = None
        self.redirect_error: StampedeError | None = None
        self.over = asyncio.Event()

    async def decided(self, queue: str) -> None:
        """Wait for the end of the move, for HELD_SECONDS_MAX at most. `queue`: its name, for people.

        Raises StaleBinding (MOVED) if the queue has moved, and Overloaded.
        """
        try:
            async with asyncio.timeout(HELD_SECONDS_MAX):
                await self.over.wait()
        except TimeoutError:
            raise Overloaded(f"queue {queue} is moving to another host, which takes too long; try again") from None
        if self.redirect_error is not None:
            raise self.redirect_error
