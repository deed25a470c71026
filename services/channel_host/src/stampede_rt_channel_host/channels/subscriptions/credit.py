"""The credit of a reader (decision 0064).

The reader grants credit as it takes messages. The host spends credit with each message that it sends. A subscription to
cut events counts its credit in events. Subscriptions to items and to matches count it in bytes.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from grpc.aio import EOF

CREDIT_MAX = 2**62


class Credit:
    """The credit of one stream. Calls `on_change` when the reader grants credit, and when the reader closes its side.

    `amount_left` may be below 0, because the last message may have cost more than the amount that was left. `is_final`:
    the reader has closed its side, and grants no further credit.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self.amount_left = 0
        self.is_final = False
        self._is_for_one = False  # whether the credit is for one response

    @property
    def is_over(self) -> bool:
        """Whether the host must not send any more."""
        return self.is_final and self.amount_left <= 0

    def grant(self, amount: int, *, one_response: bool = False) -> None:
        """Add the credit that the reader granted.

        `one_response`: the new credit replaces the unspent credit, and the next response with items uses up all of it.
        """
        if amount:
            rest = 0 if one_response or self._is_for_one else self.amount_left
            self.amount_left, self._is_for_one = min(rest + amount, CREDIT_MAX), one_response
            self._on_change()

    def spend(self, amount: int) -> None:
        """Subtract the credit that a sent message costs."""
        self.amount_left = 0 if self._is_for_one and amount else self.amount_left - amount

    def close(self) -> None:
        """Never call `on_change` again, because `on_change` usually refers to the owner of this object (a cycle)."""
        self._on_change = lambda: None

    def end(self) -> None:
        """Note that the reader grants no further credit."""
        self.is_final = True
        self._on_change()


async def requests_of(read: Callable[[], Awaitable[Any]]) -> AsyncIterator[Any]:
    """The requests on a stream, until the caller closes its side."""
    while (request := await read()) is not EOF:
        yield request
