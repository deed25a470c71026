"""Writes the messages of one feed, within the credit that the copy grants."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.frames import MESSAGE_BYTES_MAX, Delivery, Sendable
from stampede_rt_channel_host.channels.subscriptions.credit import Credit
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.rpc import Context, takes_parts, write_now

WRITE_SECONDS_MAX = 10.0  # the stream of a copy ends if the copy takes nothing for this time during a write


class FeedWriter:
    """The writing side of a feed's stream."""

    def __init__(self, context: Context, credit: Credit) -> None:
        """`credit`: the bytes of items that the copy still takes."""
        self._context = context
        self._credit = credit
        self._work = current_work()

    @property
    def limit_bytes(self) -> int:
        """The most bytes of items in the next message."""
        return max(0, min(self._credit.amount_left, MESSAGE_BYTES_MAX))

    @property
    def write_now(self) -> Callable[[Sendable], None] | None:
        """Writes a message in this turn of the event loop. None if the next part of the feed has to wait."""
        may_write = self._credit.amount_left > 0 and not self._work.must_wait
        return write_now(self._context) if may_write else None

    def spend(self, charge_bytes: int) -> None:
        """Note that a message with items is written now. `charge_bytes`: the cost of its items."""
        self._credit.spend(charge_bytes)
        self._work.spend_write()

    def message(self, delivery: Delivery) -> Sendable:
        """The message of a delivery, which is written now."""
        self.spend(delivery.charge_bytes)
        return delivery.message(takes_parts=takes_parts(self._context))

    async def turn(self) -> None:
        """Wait for the turn of the copy's host, if it has used more than its share of the event loop's time."""
        if self._work.must_wait:
            await self._work.turn()

    async def write(self, message: Sendable) -> None:
        """Write a message. Raises Overloaded if the copy takes nothing for WRITE_SECONDS_MAX."""
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
        except TimeoutError:
            raise Overloaded(
                f"the copy took nothing for {WRITE_SECONDS_MAX:g} s, and its feed is ended; feed it again when it can "
                "take items"
            ) from None
