"""Changes the items of a channel: stores new items, outdates old items, and frees the memory of outdated items. Pure.

The channel frees this memory later, in parts. So a policy that outdates a million items in one step delays no other
caller.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

from stampede_rt_channel_host.core.channel import item_blocks
from stampede_rt_channel_host.core.channel.held_items import CONSUMPTION, COPIED_BYTES_MIN, HeldItems
from stampede_rt_channel_host.core.channel.item_blocks import NO_BLOCKS, WholeBlocks
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.oldest_items import (
    CountOldest,
    OldestItems,
    before,
    first_bytes,
    first_items,
)
from stampede_rt_channel_host.core.channel.run import ABSENT, ITEM_OVERHEAD_BYTES, ColumnRun, Run, Slice, TimeSpan
from stampede_rt_channel_host.core.channel.span_ends import end_of_newest, latest_end

REPORTED_SLICES_MAX = 64
"""The most collected slices that one call reports to the consumers. The next calls report the rest."""

FREED_ENTRIES_MAX = 2048
"""The most entries that one call frees, however many items are outdated. The next calls free the rest."""

COPIED_DIVISOR = 4
COPIED_PARTS_MAX = 4
"""A channel copies the few remaining items of a run, and frees the run's body, if the body has more than
COPIED_BYTES_MIN bytes, and at most 1 / COPIED_DIVISOR of the items remain, in at most COPIED_PARTS_MAX parts."""


class Holdings(HeldItems):
    """The items of a channel, with the operations that change them.

    Acceptance stores items, and retention outdates them.
    """

    __slots__ = ()

    def store(self, run: Run, payload_bytes: int, span: TimeSpan) -> None:
        """Add a run. `payload_bytes`: the payload bytes of its items. `span`: the span of its times."""
        if (low := span.low) < self.floor[0]:
            self._reset_floor()
        if self.newest is not None and low < self.newest:
            self.late += sum(time < self.newest for time in run.times)
        self.index.insert(run)
        self._stored_items += len(run)
        if isinstance(run, ColumnRun):
            run.kept = len(run)
        self._kept_body_bytes += len(run.body)
        if low < self._blocks.end[0]:
            self._split_block(self._blocks.add_late(run.first_seq, run.times, run.lengths))
        self._count_in(len(run), payload_bytes, low)
        self._count_newest(len(run), payload_bytes, span.high)
        if run.durations is None:
            self._note_newest(span.high, ABSENT)
        else:
            for time, duration in zip(run.times, run.durations, strict=True):
                self._note_newest(time, duration)

    def count_body(self, run: ColumnRun) -> None:
        """Count the body of a run whose items were stored one by one."""
        if run.kept:
            self._kept_body_bytes += len(run.body)
            self._trim(self._free_floor)

    def store_item(self, run: ColumnRun, at: int, payload_bytes: int) -> None:
        """Add the item at position `at` of a run. Store the items of a run in their order."""
        time = run.times[at]
        if time < self.floor[0]:
            self._reset_floor()
        if self.newest is not None and time < self.newest:
            self.late += 1
        self.index.insert_item(run, at)
        run.kept += 1
        self._stored_items += 1
        if time < self._blocks.end[0]:
            self._split_block(self._blocks.add_late(run.first_seq + at, (time,), (payload_bytes,)))
        self._count_in(1, payload_bytes, time)
        self._count_newest(1, payload_bytes, time)
        self._note_newest(time, ABSENT if run.durations is None else run.durations[at])

    def _reset_floor(self) -> None:
        """Free all outdated items, and reset the floor, because a new item is earlier than some consumed items.

        The outdated items are few, except items that a snapshot has kept, for two reasons. First, consumption outdates
        nothing while many items wait to be freed (see `Retention.collect_consumed`). Second, only consumed items may be
        later than a new item: the channel refuses an item earlier than items that were outdated for another cause.
        """
        self.floor_resets += 1
        for note_reset in self._on_floor_reset or ():
            note_reset(self.floor)
        for snapshot in self._snapshots:
            snapshot.detach(self.floor)
        while self.report_gone(REPORTED_SLICES_MAX) or self._free_entry(self._free_floor):
            pass
        trimmed = self.index.trim_below(self.floor)
        if trimmed is not None:
            self._forget(trimmed)
        self.floor = self._reported_to = FIRST_KEY

    def _split_block(self, crowded: tuple[ItemKey, ItemKey] | None) -> None:
        """Split a block that late items have made too large."""
        if crowded is None:
            return
        low, high = crowded
        items = payload_bytes = 0
        for part in self.slices(low, high):
            items += part.items
            payload_bytes += part.payload_bytes
            if items >= item_blocks.BLOCK_ITEMS:
                at = part.last_time, part.end_seq
                if at < high:
                    self._blocks.split(at, items, payload_bytes)
                return

    def _count_in(self, items: int, payload_bytes: int, low: int) -> None:
        """Add new items to all counts. `low`: the time of the earliest one. Closes a block if it is full."""
        self._following, self.shared_batches = (None, None), None
        outside = self.items - self._blocks.items
        if outside >= item_blocks.BLOCK_ITEMS and self.newest is not None and low >= self.newest:
            end = self.newest, self.next_seq
            self._blocks.close(end, outside, self.payload_bytes - self._blocks.payload_bytes)
        self.items += items
        self.payload_bytes += payload_bytes
        self.accepted += items
        self.accepted_bytes += payload_bytes
        self._stored_bytes += payload_bytes + items * ITEM_OVERHEAD_BYTES
        if self.oldest is None or low < self.oldest:
            self.oldest = low
        if self.items - self._blocks.items >= 2 * item_blocks.BLOCK_ITEMS:
            self._close_block()

    def _count_newest(self, items: int, payload_bytes: int, high: int) -> None:
        """Count new items in the newest bucket, if the latest of them, at `high`, belongs there. The earlier ones count
        there, too: the count needs to be an upper bound only.
        """
        if self.newest is not None and high < self.newest:
            return
        if self.newest is None or high > self.newest:
            self._newest_items_most = self._newest_bytes_most = 0
        self._newest_items_most += items
        self._newest_bytes_most += payload_bytes + items * ITEM_OVERHEAD_BYTES

    def _close_block(self) -> None:
        """Add a block, because very many items earlier than the newest one are in no block."""
        items = payload_bytes = 0
        for part in self.slices(self._blocks.end):
            items += part.items
            payload_bytes += part.payload_bytes
            if items >= item_blocks.BLOCK_ITEMS:
                self._blocks.close((part.last_time, part.end_seq), items, payload_bytes)
                return

    def _note_newest(self, time: int, duration: int) -> None:
        """Note the time and duration of a new item."""
        if self.newest is None or time > self.newest:
            self.newest, self._newest_is_open, self._newest_longest = time, duration == ABSENT, max(duration, 0)
        elif time == self.newest:
            self._newest_is_open |= duration == ABSENT
            self._newest_longest = max(self._newest_longest, duration)

    def oldest_items(self, count: CountOldest, whole: WholeBlocks = NO_BLOCKS) -> OldestItems:
        """The oldest held items: all items of the blocks `whole`, and the `count` items after these blocks."""
        items, payload_bytes = whole.items, whole.payload_bytes
        last: Slice | None = None
        for part in self.slices(whole.end) if items else self.index.slices_from(self.floor):
            taken = count(part)
            if taken:
                last = part if taken == part.items else Slice(part.run, part.lo, part.lo + taken)
                items += taken
                payload_bytes += last.payload_bytes
            if taken < part.items:
                rest = Slice(part.run, part.lo + taken, part.hi)
                return OldestItems(items, payload_bytes, last or self._last_of(whole), rest)
        return OldestItems(items, payload_bytes, last or self._last_of(whole), None)

    def _last_of(self, whole: WholeBlocks) -> Slice | None:
        """The last slice in these blocks, or None if there are no blocks."""
        return next(self.slices_down(FIRST_KEY, whole.end), None) if whole.items else None

    def oldest_before(self, time: int) -> OldestItems:
        """The held items before `time`."""
        return self.oldest_items(before(time), self._blocks.whole_below((time, 0)))

    def oldest_by_count(self, count: int) -> OldestItems:
        """The oldest `count` items."""
        if count == 1 and (oldest := self.index.oldest_item(self.floor)) is not None:
            return oldest
        whole = self._blocks.whole_within(items=count)
        return self.oldest_items(first_items(count - whole.items), whole)

    def oldest_by_bytes(self, charged_bytes: int) -> OldestItems:
        """The fewest oldest items that are together charged with at least `charged_bytes`."""
        whole = self._blocks.whole_within(charged_bytes=charged_bytes)
        in_blocks = whole.payload_bytes + whole.items * ITEM_OVERHEAD_BYTES
        return self.oldest_items(first_bytes(charged_bytes - in_blocks), whole)

    def time_after(self, oldest: OldestItems) -> int | None:
        """The time of the bucket after the last bucket of `oldest`, or None if there is no such bucket or item."""
        if oldest.rest is None or oldest.last is None:
            return None
        last_time, first_held = oldest.last.last_time, oldest.rest.first_time
        return first_held if first_held > last_time else self.next_time(last_time)

    def outdate(self, oldest: OldestItems, cause: str, now: int) -> None:
        """Collect the oldest items.

        Open spans of the newest bucket end at `now`, if `oldest` has items of that bucket.
        """
        last = oldest.last
        if last is None:
            return
        self.last_cause, self.shared_batches = cause, None
        if cause == CONSUMPTION:  # consumption does not move the frontier: earlier items may still come
            before = self.newest_consumed
            self.newest_consumed = last.last_time if before is None else max(before, last.last_time)
        else:
            self._note_end(oldest, last, cause, now)
        # The floor is not the key of the next held item, because another item may come between the two.
        self.floor = last.last_time, last.end_seq
        self._count_collected(oldest, cause)
        if oldest.rest is None:
            self.frontier_max = last.last_time if cause == CONSUMPTION else max(last.last_time, now)
        self.report_gone(REPORTED_SLICES_MAX)

    def _count_collected(self, oldest: OldestItems, cause: str) -> None:
        """Count the oldest items as collected."""
        self.items -= oldest.items
        self.payload_bytes -= oldest.payload_bytes
        self._blocks.take(oldest.items, oldest.payload_bytes)
        self.collected[cause] += oldest.items
        self.oldest = None if oldest.rest is None else oldest.rest.first_time
        if oldest.rest is None:
            self.newest = None

    def report_resets_to(self, note_reset: Callable[[ItemKey], None], *, stop: bool = False) -> None:
        """From now on call `note_reset` with the floor before each reset of the floor. `stop`: stop these calls."""
        listeners = self._on_floor_reset or {}
        if stop:
            listeners.pop(note_reset, None)
        else:
            listeners[note_reset] = None
        self._on_floor_reset = listeners or None

    def report_gone_to(self, on_gone: Callable[[int, int], None] | None) -> None:
        """From now on call `on_gone` with the seqs of collected items: the first seq and the end, exclusive.

        None stops these calls.
        """
        self._on_gone, self._reported_to = on_gone, self.floor

    def report_gone(self, slices_max: int) -> bool:
        """Report up to `slices_max` collected slices to `on_gone`. Returns True if more are left.

        The channel frees a slice only after its report to `on_gone`.
        """
        if self._on_gone is None or self._reported_to >= self.floor:
            return False
        parts = [*islice(self.index.slices(self._reported_to, self.floor), slices_max)]
        for part in parts:
            self._on_gone(part.first_seq, part.end_seq)
        self._reported_to = (parts[-1].last_time, parts[-1].end_seq) if len(parts) == slices_max else self.floor
        return self._reported_to < self.floor

    def _note_end(self, oldest: OldestItems, last: Slice, cause: str, now: int) -> None:
        """Note the latest span end of the oldest items, of which `last` is the last slice.

        Earlier buckets end at or before the last bucket's time, so only the last bucket counts.
        """
        time, following = last.last_time, self.time_after(oldest)
        # The usual case: a full channel has accepted one item and drops one item, which the caller passes as `last`.
        is_one = oldest.items == last.items == 1
        bucket = iter((last,)) if is_one else self.slices((time, 0), (time, last.end_seq))
        if following is not None:
            end = latest_end(bucket, time, following)
        else:
            newest_end = self.newest_end(now)
            assert newest_end is not None, "`oldest` is not empty"
            end = end_of_newest(bucket, time, now, newest_end)
        end = max(end, time + max(1, self.overlap_nanos))  # a span without a length also has the instant `time`
        if self.collected_end is None or end >= self.collected_end:
            self.collected_end = end
            self.collected_by = cause
        if self.newest_collected is None or time > self.newest_collected:
            self.newest_collected = time

    def free(self, entries_max: int, backlog_bytes_max: int | None = None, *, trims: bool = True) -> bool:
        """Free up to `entries_max` entries of outdated items. Returns True if another call may free more.

        While the outdated items are charged with more than `backlog_bytes_max`, frees more entries, but at most
        FREED_ENTRIES_MAX. `trims` False: leaves an entry with held items to a call that trims.
        """
        floor: ItemKey | None = None
        for freed in range(FREED_ENTRIES_MAX):
            if self._stored_items == self.items:  # nothing is outdated
                self._trim_is_due = False
                return False
            if freed >= entries_max and (backlog_bytes_max is None or self.backlog_bytes <= backlog_bytes_max):
                return self.has_backlog
            if not self._free_entry(floor := floor or self._free_floor):
                # In a steady flow the next call frees the whole entry, so a copy of its rest would be of no use.
                self._trim_is_due = (freed > 0 or not trims) and self._may_trim(floor)
                if not self._trim_is_due:
                    self._trim(floor)
                return self._trim_is_due
        return self.has_backlog

    def _free_entry(self, floor: ItemKey) -> bool:
        """Free the first entry if all its items are below `floor`. Returns whether it did."""
        entry = self.index.pop_below(floor)
        if entry is not None:
            self.freed_entries += 1
            self._forget(Slice(entry.run, entry.lo, entry.hi))
        return entry is not None

    def _trim(self, floor: ItemKey) -> None:
        """Free the first entry's items below `floor`, if they are at least three quarters of a large run."""
        trimmed = self.index.trim_below(floor) if self._may_trim(floor) else None
        if trimmed is not None:
            self._forget(trimmed)

    def _forget(self, part: Slice) -> None:
        """Subtract freed items from the sums of memory. If few items of a large run are left, also free its body."""
        self._stored_bytes -= part.payload_bytes + part.items * ITEM_OVERHEAD_BYTES
        self._stored_items -= part.items
        run = part.run
        if not isinstance(run, ColumnRun):
            self._kept_body_bytes -= len(run.body)
            return
        run.kept -= part.items
        if not run.kept:
            self._kept_body_bytes -= len(run.body)
        elif run.kept * COPIED_DIVISOR <= len(run) and len(run.body) > COPIED_BYTES_MIN:
            self._copy_rest(run)

    def _copy_rest(self, run: ColumnRun) -> None:
        """Copy the remaining items of a run into new, smaller runs, if these take at most half of the body's memory."""
        parts = self.index.parts_of(run, COPIED_PARTS_MAX + 1)
        if self._cut is None or len(parts) > COPIED_PARTS_MAX:
            return
        bodies = [self._cut(bytes(run.body), part.lo, part.hi) for part in parts]
        if 2 * sum(len(body) for body in bodies) > len(run.body):
            return
        self._kept_body_bytes -= len(run.body)
        for part, body in zip(parts, bodies, strict=True):
            part.refer_to(run.part(part.lo, part.hi, body))
            self._kept_body_bytes += len(body)
