# Generated from ../_async by tools/generate.py; do not edit.
"""The iterator over the batches of a subscription."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.values.answers import ItemBatch


class Batches:
    """An iterator over the batches of a subscription (see `Subscription.batches`)."""

    def __init__(self, step: Callable[[], ItemBatch | None]) -> None:
        """`step` waits for the next batch, and returns None at the end."""
        self._step = step

    def __iter__(self) -> Batches:
        return self

    def __next__(self) -> ItemBatch:
        batch = self._step()
        if batch is None:
            raise StopIteration
        return batch
