"""The iterator over the batches of a subscription."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from stampede_rt.values.answers import ItemBatch


class Batches:
    """An iterator over the batches of a subscription (see `Subscription.batches`)."""

    def __init__(self, step: Callable[[], Awaitable[ItemBatch | None]]) -> None:
        """`step` waits for the next batch, and returns None at the end."""
        self._step = step

    def __aiter__(self) -> Batches:
        return self

    async def __anext__(self) -> ItemBatch:
        batch = await self._step()
        if batch is None:
            raise StopAsyncIteration
        return batch
