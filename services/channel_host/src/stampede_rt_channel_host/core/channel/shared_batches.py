"""Batches of subscriptions that several readers take at the same place of a channel. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt_channel_host.core.channel.values import SubscriptionBatch

PLACES_MAX = 4
"""The most batches that a channel keeps. A batch has references to at most 256 held slices, and no bytes of items."""


Place = tuple[int, bool]
"""The seq of a reader's next item, and whether the reader is a copy of the channel, whose slices are joined."""


class SharedBatch(NamedTuple):
    """A batch without a gap: its items, their cost in a reader's credit, and the seq after the last of them."""

    batch: SubscriptionBatch
    items: int
    charge_bytes: int
    end_seq: int


class SharedBatches:
    """The batches that readers have taken since the last change of a channel's items, by the place of these readers.

    A batch that a limit has cut off is only for readers with the same limit.
    """

    __slots__ = ("_cut", "_whole")

    def __init__(self) -> None:
        self._whole: dict[Place, SharedBatch] = {}
        self._cut: dict[tuple[Place, int], SharedBatch] = {}

    def find(self, place: Place, limit_bytes: int) -> SharedBatch | None:
        """The batch for a reader at `place` with this limit, or None."""
        whole = self._whole.get(place)
        if whole is not None and whole.charge_bytes < limit_bytes:
            return whole
        return self._cut.get((place, limit_bytes))

    def keep(self, place: Place, limit_bytes: int, shared: SharedBatch) -> None:
        """Keep a batch that a reader at `place` has taken with this limit."""
        if len(self._whole) + len(self._cut) >= PLACES_MAX:
            self._whole.clear()
            self._cut.clear()
        if shared.charge_bytes < limit_bytes:
            self._whole[place] = shared
        else:
            self._cut[place, limit_bytes] = shared
