"""Makes lookups in the directory in the background: of each thing at most one at a time, with a pause after it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from typing import Any

from stampede_rt.errors import StampedeError

logger = logging.getLogger(__name__)

LOOKUPS_MAX = 1_000  # the most lookups at the same time
PAUSE_SECONDS = 0.2  # between two lookups of the same thing


class BackgroundLookups:
    """The lookups in the directory that are under way. If a lookup fails, the host only logs the failure.

    Drops a lookup beyond LOOKUPS_MAX. So the caller must remember its lookup, and call `start` again
    until the answer comes.
    """

    def __init__(self) -> None:
        self._running: dict[bytes | None, asyncio.Task[None]] = {}
        self._closed = False

    def start(self, about: bytes | None, work: Coroutine[Any, Any, None]) -> None:
        """Run `work`, the lookup of the thing `about`, in a task. Does not wait.

        Does nothing if a lookup of this thing is under way, or ended less than PAUSE_SECONDS ago. `about` None: the
        lookup is not about one thing.
        """
        if self._closed or about in self._running or len(self._running) >= LOOKUPS_MAX:
            work.close()
            return
        task = self._running[about] = asyncio.create_task(_paced(work))
        task.add_done_callback(lambda _: self._running.pop(about, None))

    def close(self) -> None:
        """Cancel all lookups, and start no more."""
        self._closed = True
        for task in list(self._running.values()):
            task.cancel()


async def _paced(work: Coroutine[Any, Any, None]) -> None:
    try:
        await work
    except StampedeError as error:
        logger.debug(
            "the directory gives no answer about a group", extra={"event": "group_lookup_failed", "why": str(error)}
        )
    await asyncio.sleep(PAUSE_SECONDS)
