"""The credit of a reader (decision 0064): the reader grants it as it takes items, and the host spends it as it
sends."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from grpc.aio import EOF

CREDIT_MAX = 2**62


class Credit:
    """Of one stream. `left` may be below 0: the last item may have taken more than there was.

    `is_final`: the reader has closed its side, and grants no more.
    """

    def __init__(self, on_news: Callable[[], None]) -> None:
        self._on_news = on_news
        self.left = 0
        self.is_final = False

    @property
    def is_over(self) -> bool:
        """Nothing may be sent any more."""
        return self.is_final and self.left <= 0

    def grant(self, amount: int) -> None:
        """The reader takes so much more."""
        if amount:
            self.left = min(self.left + amount, CREDIT_MAX)
            self._on_news()

    def spend(self, amount: int) -> None:
        """So much was sent."""
        self.left -= amount

    def end(self) -> None:
        """The reader grants no more."""
        self.is_final = True
        self._on_news()


async def requests_of(read: Callable[[], Awaitable[Any]]) -> AsyncIterator[Any]:
    """The requests on a stream, until the caller closes its side."""
    while (request := await read()) is not EOF:
        yield request
