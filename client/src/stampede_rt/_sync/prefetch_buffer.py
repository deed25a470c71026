# Generated from ../_async by tools/generate.py; do not edit.
"""Messages that the host sent before a caller asked for them, and their leases."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from stampede_rt._sync.message import Message, Settler
from stampede_rt.errors import StampedeError
from stampede_rt.transports.concurrency_sync import BackgroundTask, Mutex, Signal

LEASE_PARTS = 3  # a lease is due when one third of it is left
_log = logging.getLogger("stampede_rt")


class PrefetchBuffer:
    """Prefetched messages of one taker, in the order of their delivery. The buffer also renews their leases.

    The buffer renews the leases as long as callers take messages. If no caller takes a message for two thirds of a
    lease, the messages go back to the queue, and other takers get them.
    """

    def __init__(self, settler: Settler, give_back: Callable[[list[Message]], None], name: str) -> None:
        self._settler = settler
        self._give_back = give_back
        self._name = name
        self._mutex = Mutex()  # guards the messages
        self._waiting: deque[Message] = deque()
        self._untouched: set[Message] = set()  # messages whose leases began, or were renewed, after the last `take`
        self._changed = Signal()
        self._keeper: BackgroundTask | None = None

    def __len__(self) -> int:
        """The number of messages."""
        return len(self._waiting)

    def add(self, message: Message, *, first: bool = False) -> None:
        """Add a message at the end, or with `first` at the beginning."""
        with self._mutex:
            (self._waiting.appendleft if first else self._waiting.append)(message)
            self._untouched.add(message)
            if self._keeper is None:
                self._keeper = BackgroundTask(self._keep, f"leases of {self._name}")
        self._changed.set()

    def take(self) -> Message | None:
        """Remove and return the first message that is still leased to this taker; None if there is none."""
        with self._mutex:
            self._untouched.clear()
            while self._waiting:
                message = self._waiting.popleft()
                if message.lease_left:  # otherwise another taker may have it
                    return message
        return None

    def take_all(self) -> list[Message]:
        """Remove and return all messages that are still leased to this taker."""
        with self._mutex:
            messages = [message for message in self._waiting if message.lease_left]
            self._waiting.clear()
            self._untouched.clear()
        self._changed.set()
        return messages

    def _keep(self) -> None:
        """Renew leases or give messages back, until the buffer is empty."""
        while (wait_s := self._wait_s()) is not None:
            if wait_s > 0:
                self._changed.wait(wait_s)
                continue
            idle, kept = self._due()
            if idle:
                self._give_back(idle)
            if kept:
                self._extend(kept)

    def _wait_s(self) -> float | None:
        """Return the seconds until the next lease is due. None when the buffer is empty: `_keep` ends then."""
        with self._mutex:
            self._changed.clear()
            if not self._waiting:
                self._keeper = None
                return None
            return min(message.lease_left - message.lease_s / LEASE_PARTS for message in self._waiting)

    def _due(self) -> tuple[list[Message], list[Message]]:
        """Return two lists of messages whose leases are due: messages to give back, and messages with leases to renew.

        Removes from the buffer the messages of the first list, and messages whose leases have ended.
        """
        with self._mutex:
            due = [one for one in self._waiting if one.lease_left <= one.lease_s / LEASE_PARTS]
            idle = [one for one in due if one in self._untouched]
            self._waiting = deque(one for one in self._waiting if one not in idle and one.lease_left)
            self._untouched.difference_update(due)
        kept = [one for one in due if one not in idle and one.lease_left]
        return idle, kept

    def _extend(self, messages: list[Message]) -> None:
        """Renew the leases of `messages`. If this fails for a message, drop the message; another taker soon gets it."""
        extended: list[Message] = []
        try:
            extended = self._settler.extend(messages, min(message.lease_left for message in messages))
        except StampedeError as error:
            _log.info("the leases of %d messages of %s could not be extended: %s", len(messages), self._name, error)
        lost = [one for one in messages if one not in extended]
        with self._mutex:
            self._waiting = deque(one for one in self._waiting if one not in lost)
            self._untouched.update(extended)
