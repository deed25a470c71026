"""The items that a channel holds, for reading, and the counts of collected items. Pure.

Items below `floor` are outdated: they count as collected, and no read returns them. The channel frees their memory
later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import MAX_INSTANT
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.index_snapshot import IndexSnapshot
from stampede_rt_channel_host.core.channel.item_blocks import ItemBlocks
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES, Slice
from stampede_rt_channel_host.core.channel.shared_batches import SharedBatches
from stampede_rt_channel_host.core.channel.span_ends import latest_end
from stampede_rt_channel_host.core.channel.values import Counters

AGE, COUNT, BYTES, CONSUMPTION = "age", "count", "bytes", "consumption"
ARCHIVE = "archive"
"""The cause for which a channel that has restarted holds no earlier items: its archive has them."""
COLLECTED_FOR = (AGE, COUNT, BYTES, CONSUMPTION)
"""The causes for which a channel collects items."""

COPIED_BYTES_MIN = 4096  # a channel copies only parts of longer runs, see `Holdings`

Cut = Callable[[bytes, int, int], bytes]
"""Takes a run's body and two positions. Returns the body of the items from the first position up to the second,
exclusive.
"""


class HeldItems:
    """Held items and counts. `Holdings` adds the methods that change them.

    Always `accepted == items + sum(collected.values())`. `items` is the number of held items. `newest` and `oldest` are
    the latest and the earliest time of held items, or None if no item is held. `newest_collected` is the latest time of
    an item collected for age, count or bytes, and `collected_end` the latest span end of such an item. `collected_by`
    is the cause for which the item with that span end was collected. `newest_consumed` is the latest time of an item
    collected by consumption. `last_cause` is the cause of the last collection. `overlap_nanos`: within this time after
    an item with a duration, a later item does not end its span. `freed_entries` counts the entries freed so far.
    `passed_seqs` counts the seqs before `next_seq` that no accepted item has: `missed` of them belong to items that a
    copy never received, and no item has the others. `missed` is 0 unless the channel is a copy. `floor_resets`
    counts how often a late item has set the floor back.
    """

    __slots__ = (
        "_blocks",
        "_cut",
        "_following",
        "_kept_body_bytes",
        "_newest_bytes_most",
        "_newest_is_open",
        "_newest_items_most",
        "_newest_longest",
        "_on_floor_reset",
        "_on_gone",
        "_reported_to",
        "_snapshots",
        "_stored_bytes",
        "_stored_items",
        "_trim_is_due",
        "accepted",
        "accepted_bytes",
        "collected",
        "collected_by",
        "collected_end",
        "floor",
        "floor_resets",
        "freed_entries",
        "frontier_max",
        "index",
        "items",
        "last_cause",
        "late",
        "missed",
        "newest",
        "newest_collected",
        "newest_consumed",
        "oldest",
        "overlap_nanos",
        "passed_seqs",
        "payload_bytes",
        "shared_batches",
    )  # fmt: skip

    def __init__(self, cut: Cut | None = None) -> None:
        """`cut` copies a part of a run's body. If it is None, each body stays whole until all items of the run are
        freed.
        """
        self.index = ChannelIndex()
        self.floor: ItemKey = FIRST_KEY
        self.items = 0
        self.payload_bytes = 0
        self.newest: int | None = None
        self.oldest: int | None = None
        self.accepted = 0
        self.accepted_bytes = 0
        self.late = 0  # the items that came after an item with a later time
        self.collected = {AGE: 0, COUNT: 0, BYTES: 0, CONSUMPTION: 0}
        self.newest_collected: int | None = None
        self.collected_end: int | None = None
        self.collected_by = AGE
        self.newest_consumed: int | None = None
        self.last_cause = AGE
        self.overlap_nanos = 0
        self._on_gone: Callable[[int, int], None] | None = None  # tells the consumers; see `Holdings.tell`
        self._reported_to: ItemKey = FIRST_KEY  # the consumers know of all collected items below this key
        self.frontier_max: int | None = None  # the upper bound of `frontier` while no item is held
        # A time and the time of the next bucket, as of the last `next_time`; a new item resets both.
        self._following: tuple[int | None, int | None] = (None, None)
        self._newest_is_open = False  # whether an item of the newest bucket has no duration
        self._newest_longest = 0  # the longest duration of an item in the newest bucket
        self._newest_items_most = 0  # an upper bound of the number of items in the newest bucket
        self._newest_bytes_most = 0  # an upper bound of the charged bytes of the newest bucket
        self._snapshots: dict[IndexSnapshot, None] = {}  # the snapshots whose items must not be freed
        self._blocks = ItemBlocks()  # counts the held items, except those after its last block
        self._stored_bytes = 0  # charged bytes of every entry in the index, outdated entries included
        self._stored_items = 0  # the items of these entries
        self._kept_body_bytes = 0  # the bodies of all runs with an entry in the index
        self._cut = cut
        self._trim_is_due = False  # whether the last call of `free` has left a part of the first entry to the next call
        self.freed_entries = 0
        self.missed = self.passed_seqs = 0
        self.floor_resets = 0
        self._on_floor_reset: dict[Callable[[ItemKey], None], None] | None = None  # the feeds of copies; few have one
        self.shared_batches: SharedBatches | None = None
        """The batches that readers have taken since the last change of the items; None if there are none."""

    @property
    def next_seq(self) -> int:
        """The seq of the next accepted item."""
        return self.accepted + self.passed_seqs + 1

    def inherit_counts(self, counters: Counters) -> None:
        """Continue the counts of another owner.

        Items that it has counted, and that this host did not get, count as collected.
        """
        next_seq, known = self.next_seq, self.items + sum(counters.collected.values())
        self.accepted = max(known, given_between(1, next_seq))
        self.missed, self.passed_seqs = 0, next_seq - 1 - self.accepted
        more = self.accepted - known
        self.collected = {**counters.collected, self.last_cause: max(0, counters.collected[self.last_cause] + more)}
        self.accepted_bytes, self.late = max(self.accepted_bytes, counters.accepted_bytes), counters.late

    @property
    def charged_bytes(self) -> int:
        """The bytes that the held items count against max_bytes."""
        return self.payload_bytes + self.items * ITEM_OVERHEAD_BYTES

    @property
    def backlog_bytes(self) -> int:
        """The charged bytes of outdated items whose memory is not freed yet."""
        return self._stored_bytes - self.charged_bytes

    @property
    def footprint_bytes(self) -> int:
        """The bytes in memory: the bodies of all runs with an item in the index, and 64 bytes for each such item."""
        return self._kept_body_bytes + self._stored_items * ITEM_OVERHEAD_BYTES

    @property
    def has_backlog(self) -> bool:
        """Whether there are entries to free, now or after `report_gone` has told the consumers of them."""
        unreported = self._on_gone is not None and self._reported_to < self.floor
        return unreported or self._trim_is_due or self.index.has_below(self._free_floor)

    def _may_trim(self, floor: ItemKey) -> bool:
        """Whether at least three quarters of the first entry are below `floor`, and its run is large."""
        share = self.index.share_below(floor) if self._cut is not None else None
        return share is not None and len(share.run.body) > COPIED_BYTES_MIN and share.items * 4 >= len(share.run) * 3

    def has_backlog_of(self, entries: int) -> bool:
        """Whether there are at least this number of entries to free, now or after `report_gone`."""
        return self.index.has_below(self._below_snapshots(self.floor), entries)

    def has_outdated(self, entries: int) -> bool:
        """Whether there are at least this number of entries of outdated items, entries kept by a snapshot included."""
        return self.index.has_below(self.floor, entries)

    @property
    def _free_floor(self) -> ItemKey:
        """The key below which the channel may free items: no snapshot shows them, and the consumers know of them."""
        return self._below_snapshots(self.floor if self._on_gone is None else min(self.floor, self._reported_to))

    def _below_snapshots(self, floor: ItemKey) -> ItemKey:
        """The least of `floor` and the keys from which the held snapshots need the index."""
        return min((floor, *(one.kept_from for one in self._snapshots))) if self._snapshots else floor

    @property
    def frontier(self) -> int | None:
        """The latest span end of items collected for age, count or bytes, but not above a bound.

        The bound is the oldest held item's time. If no item is held, the bound is the time of the last collected item,
        or the clock at its collection if the clock was later. If consumption collected that item, the clock does not
        count. So the long duration of a collected item does not move the frontier past times at which items may still
        come.
        """
        bound = self.frontier_max if self.oldest is None else self.oldest
        if self.collected_end is None or bound is None:
            return self.collected_end
        return min(self.collected_end, bound)

    @property
    def end(self) -> ItemKey:
        """See `ReadableItems`: this object shows all items."""
        return LAST_KEY

    def snapshot(self) -> IndexSnapshot:
        """A snapshot of the held items. A reader can scan it while the channel changes."""
        return IndexSnapshot(self.index, self.floor, self.next_seq, self._snapshots)

    @property
    def gone_before(self) -> int | None:
        """The instant before which an answer may lack collected items.

        This instant is later than the frontier if only a part of the oldest bucket is held, because collected items of
        this bucket last as long. With overlap it may be later, too.
        """
        frontier = self.frontier
        if self.oldest is not None and self.oldest == self.newest_collected:
            following = self.next_time(self.oldest)
            frontier = MAX_INSTANT if following is None else following
        if not self.overlap_nanos or frontier is None or self.newest_collected is None:
            return frontier
        return max(frontier, self.newest_collected + self.overlap_nanos)

    def slices(self, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY) -> Iterator[Slice]:
        """Held items at or above `low` and below `high`, in ascending order."""
        return self.index.slices(max(low, self.floor), high)

    def slices_down(self, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY) -> Iterator[Slice]:
        """Like `slices`, but the last slice first."""
        return self.index.slices_down(max(low, self.floor), high)

    @property
    def newest_seq(self) -> int | None:
        """The seq of the newest item, or None if no item is held."""
        last = next(self.slices_down(), None)
        return None if last is None else last.end_seq - 1

    def newest_end(self, now: int) -> int | None:
        """The latest span end of the newest bucket, or None if no item is held. A span without a duration lasts until
        `now`.

        Collected items of this bucket count, too.
        """
        if self.newest is None:
            return None
        end = self.newest + self._newest_longest
        return max(end, now) if self._newest_is_open else end

    def reaches_no_newest(self, items: int, charged_bytes: int) -> bool:
        """Whether the oldest `items` items, and the oldest items charged with `charged_bytes`, surely lie before the
        newest bucket.
        """
        return (
            items <= self.items - self._newest_items_most
            and charged_bytes <= self.charged_bytes - self._newest_bytes_most
        )

    def items_below(self, key: ItemKey) -> int:
        """The number of held items below a key. Adds the counts of whole blocks, and scans the other items."""
        whole = self._blocks.whole_below(key)
        return whole.items + sum(part.items for part in self.slices(whole.end, key))

    def slices_by_seq(self, low: int, high: int) -> Iterator[Slice]:
        """Held items with seqs from `low` up to `high`, exclusive, in seq order."""
        return self.index.slices_by_seq(low, high, self.floor)

    def seq_from(self, low: int, high: int, entries_max: int) -> int:
        """The first held seq from `low` on, or a lower seq if the search is long (see `ChannelIndex.seq_from`)."""
        return self.index.seq_from(low, high, self.floor, entries_max)

    def held_up_to(self, low: int, high: int, entries_max: int) -> int:
        """The first seq from `low` on that is not held, `high` at most (see `ChannelIndex.held_up_to`)."""
        return self.index.held_up_to(low, high, self.floor, entries_max)

    def next_time(self, time: int) -> int | None:
        """The time of the next bucket after `time`, or None if there is none."""
        if self.newest is None or time >= self.newest:
            return None
        known, following = self._following
        if known != time:
            following = self.index.next_time(time)
            self._following = time, following
        return following

    def last_time_up_to(self, time: int) -> int | None:
        """The time of the last bucket at or before `time`, or None if there is none."""
        if self.oldest is None or time < self.oldest:
            return None
        return self.index.last_time_up_to(time)

    def bucket_end(self, time: int, bound: int) -> int:
        """The latest span end in the bucket at `time`, if `bound` is the next bucket's time."""
        if self.overlap_nanos:
            return self.counted_end(time, None, bound)
        return latest_end(self.slices((time, 0), (time, SEQ_END)), time, bound)

    def counted_end(self, time: int, own_end: int | None, bound: int) -> int:
        """The span end from which the age of an item at `time` counts.

        `own_end` is the item's time plus its duration, or None if it has no duration. `bound` is the time of the next
        bucket.

        With overlap, every item counts with the longest possible span. So a later bucket never has an earlier end.
        """
        if self.overlap_nanos:
            return max(bound, time + self.overlap_nanos)
        return bound if own_end is None else min(own_end, bound)
