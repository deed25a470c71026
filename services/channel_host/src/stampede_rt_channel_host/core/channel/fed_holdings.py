"""The items of a copy of a channel. They come from a feed, and the feed also says which of them leave. Pure."""

from __future__ import annotations

from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.core.channel.feeding import CollectionFacts
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.oldest_items import OldestItems, below
from stampede_rt_channel_host.core.channel.run import Run


class FedHoldings(Holdings):
    """Holdings whose seqs may have gaps, and from which the feed's `CollectionFacts` takes items."""

    __slots__ = ()

    @classmethod
    def of(cls, held: Holdings) -> FedHoldings:
        """The items of a former owner, in the same object: snapshots and feeds may still refer to it."""
        held.__class__ = cls
        assert isinstance(held, cls), "both classes have the same slots"
        return held

    def store_fed(self, run: Run) -> None:
        """Add a run of the feed. The seqs between the last run and this one count as missed."""
        self.skip_to(run.first_seq)
        self.store(run, run.payload_bytes(0, len(run)), run.span)

    def skip_to(self, next_seq: int) -> None:
        """Pass the seqs up to `next_seq`, exclusive. Those that belong to items count as missed."""
        self.missed += given_between(self.next_seq, next_seq)
        self.passed_seqs += max(0, next_seq - self.next_seq)

    def clear_below(self, key: ItemKey) -> None:
        """Collect and free the items below `key`, because the source has done so and then set its floor back."""
        self._collect_below(key)
        self.floor = max(self.floor, key)
        self._reset_floor()

    def follow(self, collection: CollectionFacts) -> None:
        """Collect the items that the source has collected, and take over the facts about them.

        A copy that was the owner may have collected a few items that the source still holds. The source collects them
        soon.
        """
        if collection.floor_resets == self.floor_resets and collection.floor < self.floor:
            return
        self.last_cause, self.shared_batches = collection.last_cause, None
        self._collect_below(collection.floor)
        self.floor = self._reported_to = collection.floor
        self.floor_resets = collection.floor_resets
        self.newest_collected = collection.newest_collected
        self.collected_end, self.collected_by = collection.collected_end, collection.collected_by
        self.newest_consumed, self.frontier_max = collection.newest_consumed, collection.frontier_max

    def _one_below(self, key: ItemKey) -> OldestItems | None:
        """The item below `key` if there is exactly one. None: there is none, or the index needs a longer search."""
        oldest = self.index.oldest_item(self.floor)
        if oldest is None or oldest.last is None or (oldest.last.first_time, oldest.last.first_seq) >= key:
            return None
        rest = oldest.rest
        return oldest if rest is None or (rest.first_time, rest.first_seq) >= key else None

    def _collect_below(self, key: ItemKey) -> None:
        oldest = self._one_below(key) or self.oldest_items(below(key), self._blocks.whole_below(key))
        if oldest.items:
            self._count_collected(oldest, self.last_cause)
