"""Messages that came ahead of the gets that they are for, and the leases on them."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Awaitable, Callable

from stampede_rt._async.message import Message, Settler
from stampede_rt.errors import StampedeError
from stampede_rt.transports.concurrency_async import BackgroundTask, Mutex, Signal

LEASE_PARTS = 3  # a lease is looked after when one of so many parts is left of it
_log = logging.getLogger("stampede_rt")


class PrefetchBuffer:
    """Waiting messages of one taker, in their order. Their leases do not run out while they wait.

    As long as messages are taken, the leases of the others are extended. What nobody took for most of a lease goes
    back to the queue, where other takers get it.
    """

    def __init__(self, settler: Settler, give_back: Callable[[list[Message]], Awaitable[None]], name: str) -> None:
        self._settler = settler
        self._give_back = give_back
        self._name = name
        self._mutex = Mutex()  # guards the messages
        self._waiting: deque[Message] = deque()
        self._untouched: set[Message] = set()  # nothing was taken since their leases began
        self._changed = Signal()
        self._keeper: BackgroundTask | None = None

    def __len__(self) -> int:
        """How many wait."""
        return len(self._waiting)

    def add(self, message: Message, *, first: bool = False) -> None:
        """The message waits; `first`: before all others."""
        with self._mutex:
            (self._waiting.appendleft if first else self._waiting.append)(message)
            self._untouched.add(message)
            if self._keeper is None:
                self._keeper = BackgroundTask(self._keep, f"leases of {self._name}")
        self._changed.set()

    def take(self) -> Message | None:
        """The next one that is still this taker's."""
        with self._mutex:
            self._untouched.clear()
            while self._waiting:
                message = self._waiting.popleft()
                if message.lease_left:  # else it is somebody else's by now
                    return message
        return None

    def take_all(self) -> list[Message]:
        """All that are still this taker's; the leases are not looked after any more."""
        with self._mutex:
            messages = [message for message in self._waiting if message.lease_left]
            self._waiting.clear()
            self._untouched.clear()
        self._changed.set()
        return messages

    async def _keep(self) -> None:
        """Look after the leases until no message waits."""
        while (wait_s := self._wait_s()) is not None:
            if wait_s > 0:
                await self._changed.wait(wait_s)
                continue
            idle, kept = self._due()
            if idle:
                await self._give_back(idle)
            if kept:
                await self._extend(kept)

    def _wait_s(self) -> float | None:
        """When the next lease is to be looked after; None: the keeper is to end."""
        with self._mutex:
            self._changed.clear()
            if not self._waiting:
                self._keeper = None
                return None
            return min(message.lease_left - message.lease_s / LEASE_PARTS for message in self._waiting)

    def _due(self) -> tuple[list[Message], list[Message]]:
        """Whose leases are to be looked after now: those that nobody took for so long, and the others."""
        with self._mutex:
            due = [one for one in self._waiting if one.lease_left <= one.lease_s / LEASE_PARTS]
            idle = [one for one in due if one in self._untouched]
            self._waiting = deque(one for one in self._waiting if one not in idle and one.lease_left)
            self._untouched.difference_update(due)
        kept = [one for one in due if one not in idle and one.lease_left]
        return idle, kept

    async def _extend(self, messages: list[Message]) -> None:
        """For as long as they were leased at first. Those that cannot be extended are somebody else's soon."""
        extended: list[Message] = []
        try:
            extended = await self._settler.extend(messages, min(message.lease_left for message in messages))
        except StampedeError as error:
            _log.info("the leases of %d messages of %s were not extended: %s", len(messages), self._name, error)
        lost = [one for one in messages if one not in extended]
        with self._mutex:
            self._waiting = deque(one for one in self._waiting if one not in lost)
            self._untouched.update(extended)
