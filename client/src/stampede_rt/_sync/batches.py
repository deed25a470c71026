# Generated from ../_async by tools/generate.py; do not edit.
"""The iterator over the batches of a subscription."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.values.answers import ItemBatch


class Batches:
    """An iterator over the batches of a subscription. Each step blocks until the next item, and returns the items that
    came with it.

    These are the items of one message of the host, at most 1 MiB or one larger item. A program that works for more than
    1 ms on a batch gets next the items that the host has accepted meanwhile, up to that limit. In mode "newest" a batch
    has one item. The columns `times`, `seqs` and `payloads` of a batch need no Item, so a program that reads them takes
    about half the time for small items. Steps of the iterator and steps of the subscription may take turns. They raise
    the same errors, and `close` ends both.
    """

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
