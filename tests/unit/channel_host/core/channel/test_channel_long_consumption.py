"""Consumers of large channels: each call takes a bounded number of steps, in any order of consumption."""

from __future__ import annotations

from itertools import pairwise

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import pieces, seq_set
from stampede_rt_channel_host.core.channel.consumer_places import LEASE_NANOS
from stampede_rt_channel_host.core.channel.consumption import CONSUMERS_CHECKED_MAX, RANGES_PER_LOOK_MAX, Consumers
from stampede_rt_channel_host.core.channel.item_blocks import BLOCK_ITEMS
from stampede_rt_channel_host.core.channel.retention import BACKLOG_ENTRIES_MAX, READS_RETRY_NANOS, SLICES_CONSUMED_MAX
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put
from tests.support.channel_host.large_channels import (
    ITEMS,
    SliceCounter,
    backwards,
    count_slices,
    everything,
    filled,
    shuffled,
)


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> SliceCounter:
    return count_slices(monkeypatch)


def test_items_that_many_consumers_consumed_out_of_order_leave_after_a_bounded_number_of_steps() -> None:
    """In an earlier version, the core looked at all 1024 consumers for each of 64 slices."""
    consumers, items = 300, 40
    channel = a_channel(consumers=consumers)
    for time in reversed(range(items)):
        put(channel, CLOCK + time)
    counted, most = channel.look(CLOCK)[1].consumers, 0
    assert counted is not None
    for consumer in range(1, consumers + 1):
        before = counted.looked_at
        channel.consume(consumer, range(2, items + 1), CLOCK)  # the first seq belongs to the newest item
        most = max(most, counted.looked_at - before)
    more = True
    while more:
        before = counted.looked_at
        more = channel.collect(CLOCK)
        most = max(most, counted.looked_at - before)
    assert channel.look(CLOCK)[0].items == 1
    assert most <= 2 * (CONSUMERS_CHECKED_MAX + consumers)


def test_setting_up_consumers_of_a_full_channel_does_not_scan_its_items(looked: SliceCounter) -> None:
    channel = shuffled()
    looked.slices = 0
    channel.configure(Policy(consumers=1, max_age_nanos=10**12), CLOCK)
    assert looked.slices <= 20
    most = before = 0
    for _ in channel.catching_up(CLOCK):
        most, before = max(most, looked.slices - before), looked.slices
    assert most <= 4 * pieces.STEPS_PER_PIECE
    assert channel.consume(1, range(1, 101), CLOCK).items == 100
    assert [one.waiting for one in channel.consumers(CLOCK)] == [ITEMS - 100]


def test_no_consumer_owes_an_item_that_was_collected_while_new_consumers_learn_of_collected_items() -> None:
    channel = backwards(3000)
    channel.configure(Policy(max_items=2000, max_age_nanos=10**12), CLOCK)
    channel.configure(Policy(max_items=2000, max_age_nanos=10**12, consumers=1), CLOCK)
    for at, _ in enumerate(channel.catching_up(CLOCK)):
        put(channel, CLOCK + at)  # collects the earliest item; its seq is the highest of the first 2000
    channel.consume(1, [1], CLOCK)
    assert [one.waiting for one in channel.consumers(CLOCK)] == [1999]
    assert channel.counters(CLOCK).held == 2000


def test_the_count_of_items_that_wait_for_a_consumer_needs_no_scan_of_collected_items(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    channel = backwards(ITEMS, consumers=10)
    for consumer in range(1, 11):
        channel.consume(consumer, [], CLOCK)
    channel.configure(Policy(max_items=1, max_age_nanos=10**12, consumers=10), CLOCK)  # leaves seq 1
    for _ in channel.catching_up(CLOCK):
        pass
    for time in range(1, 2 * BLOCK_ITEMS):  # each item replaces the item before it
        put(channel, CLOCK + time)
    calls, add = 0, seq_set.SeqSet.add

    def counting(self: seq_set.SeqSet, first: int, end: int) -> int:
        nonlocal calls
        calls += 1
        return add(self, first, end)

    monkeypatch.setattr(seq_set.SeqSet, "add", counting)
    assert [one.waiting for one in channel.consumers(CLOCK)] == [channel.counters(CLOCK).held] * 10 == [1] * 10
    assert calls == 0


def test_the_status_of_consumers_that_have_consumed_much_out_of_order_is_counted_in_pieces() -> None:
    channel = filled(4 * pieces.STEPS_PER_PIECE, consumers=3)
    for consumer in (1, 2, 3):
        channel.consume(consumer, range(2, 4 * pieces.STEPS_PER_PIECE + 1, 2), CLOCK)
    counting = channel.counting_consumers(CLOCK)
    assert sum(1 for _ in counting) >= 3 * 2
    assert {one.waiting for one in channel.consumers(CLOCK)} == {2 * pieces.STEPS_PER_PIECE}


def test_the_state_of_a_consumer_is_bounded_by_the_held_items() -> None:
    channel = a_channel(consumers=2, max_items=100)
    put(channel, CLOCK + 10**6)  # is never consumed
    for time in range(5000):
        put(channel, CLOCK + time)
        if time % 2:
            channel.consume(1, [channel.next_seq - 1], CLOCK)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    done = retention.consumers.table._taken[1].done
    assert done is not None
    assert len(done.ranges) <= 150


def test_a_consumer_with_many_consumed_items_after_a_gap_advances_over_them_in_steps() -> None:
    channel = filled(4000, consumers=2)
    channel.consume(1, range(3, 4001, 2), CLOCK)
    channel.consume(2, [], CLOCK)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    for seq in range(2, 4000, 2):
        retention.consumers.note_collected(seq, seq + 1)
    place, below = retention.consumers.table._taken[1], []
    channel.consume(1, [1], CLOCK)
    while place.below < 4000:
        below.append(place.below)
        channel.consume(1, [], CLOCK)
    assert max(after - before for before, after in pairwise(below)) <= 2 * (RANGES_PER_LOOK_MAX + 16 + 1)


def test_a_consumer_merges_many_collected_ranges_a_few_at_a_time() -> None:
    """In an earlier version, one `consume` after 200,000 such ranges took 228 ms."""
    consumers, end = Consumers(1), 40_001
    consumers.consume(1, range(2, end, 2), next_seq=end, newest_seq=None, clock=0, lease=LEASE_NANOS)
    consumers.note_collected(1, end)
    done = consumers.table._taken[1].done
    assert done is not None
    left = [done.range_count]
    while left[-1]:
        consumers.consume(1, [], next_seq=end, newest_seq=None, clock=0, lease=LEASE_NANOS)
        left.append(done.range_count)
    assert max(before - after for before, after in pairwise(left)) <= 2 * RANGES_PER_LOOK_MAX + 16
    assert done.below == end


def test_consumers_are_told_of_earlier_collected_items_in_small_steps() -> None:
    consumers, end = Consumers(1), 40_001
    for seq in range(2, end, 2):
        consumers.note_collected(seq, seq + 1)
    seq, left = 1, [consumers._collected.range_count]
    while seq < end:
        seq = consumers.note_some_collected(seq, end, ranges_max=8)
        left.append(consumers._collected.range_count)
    assert max(before - after for before, after in pairwise(left)) <= 2 * 8
    assert consumers._collected.ranges == []


def test_items_that_all_consumers_consumed_are_freed_in_small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, one status collected 6 x 256 items if the consumers had consumed 200,000 items out of
    their order.
    """
    noted, note_collected = 0, Consumers.note_collected

    def counting(self: Consumers, first: int, end: int) -> None:
        nonlocal noted
        noted += 1
        note_collected(self, first, end)

    monkeypatch.setattr(Consumers, "note_collected", counting)  # the channel keeps the method when it is made
    channel = backwards(ITEMS, consumers=2)
    for consumer in (1, 2):
        channel.consume(consumer, [], CLOCK)
    for first in range(2, ITEMS + 1, 4096):  # all items except the first one, which has the latest time
        seqs = range(first, min(first + 4096, ITEMS + 1))
        for consumer in (1, 2):
            channel.consume(consumer, seqs, CLOCK)
    for look in (channel.counters, channel.next_deadline, channel.collect):
        noted, before = 0, channel.latest_counters().collected["consumption"]
        look(CLOCK)
        assert channel.oldest is not None
        assert channel.frontier is None
        assert 1 <= noted <= 2 * SLICES_CONSUMED_MAX
        assert 1 <= channel.latest_counters().collected["consumption"] - before <= 2 * SLICES_CONSUMED_MAX
    while channel.collect(CLOCK):
        pass
    assert channel.counters(CLOCK).held == 1


def test_a_late_item_before_many_outdated_items_frees_a_bounded_number_of_entries() -> None:
    """In an earlier version, the put of the late item freed all outdated items.

    With 1,000,000 of them it took 3.1 s.
    """
    channel = filled(consumers=1, max_age_nanos=10**7)
    channel.consume(1, [], CLOCK)
    put(channel, *(CLOCK + time for time in (10**5, 2 * 10**5, 3 * 10**5)))
    later = CLOCK + 10**5 + 10**7 - 1  # all items are too old, except the last three
    channel.consume(1, range(ITEMS, ITEMS + 3), later)
    most = before = channel.freed_entries
    while not channel.counters(later).collected["consumption"]:
        most, before = max(most, channel.freed_entries - before), channel.freed_entries
        assert channel.collect(later)
    before = channel.freed_entries
    assert put(channel, CLOCK + 10**5 - 5, now=later).run is not None
    most = max(most, channel.freed_entries - before)
    assert most <= 2 * BACKLOG_ENTRIES_MAX
    while channel.collect(later):
        pass
    held, _ = channel.look(later)
    assert (held.items, held.oldest, held.backlog_bytes) == (2, CLOCK + 10**5 - 5, 0)


def test_a_late_item_during_a_long_read_copies_only_the_entries_of_the_consumed_items(looked: SliceCounter) -> None:
    """In an earlier version, the put copied all entries. 1,000,000 entries took 1.9 s."""
    channel = a_channel(consumers=1, max_age_nanos=10**12)
    channel.consume(1, [], CLOCK)
    for time in range(ITEMS):
        put(channel, CLOCK + 2 * time)
    reads = [channel.reading(everything(newest_first=newest_first), CLOCK) for newest_first in (False, True)]
    for read in reads:
        next(read)
    for seq, late in ((2, CLOCK + 1), (3, CLOCK + 3)):
        channel.consume(1, range(1, seq + 1), CLOCK)
        looked.slices = 0
        assert put(channel, late).run is not None
        assert looked.slices <= 20
        channel.consume(1, [channel.next_seq - 1], CLOCK)
    for read in reads:
        assert sum(part.items for part in pieces.run_to_end(read).slices) == ITEMS


def test_a_late_item_after_much_was_consumed_during_a_long_read_frees_a_bounded_number_of_entries(
    looked: SliceCounter,
) -> None:
    """In an earlier version, the read kept all consumed entries, and the put of the late item copied and freed all of
    them in one step.
    """
    channel = a_channel(consumers=1, max_age_nanos=10**12)
    channel.consume(1, [], CLOCK)
    for time in range(ITEMS):
        put(channel, CLOCK + 2 * time)
    reads = [channel.reading(everything(newest_first=newest_first), CLOCK) for newest_first in (False, True)]
    for read in reads:
        next(read)
    for first in range(1, ITEMS, 4096):
        channel.consume(1, range(first, min(first + 4096, ITEMS)), CLOCK)
        while channel.collect(CLOCK):
            pass
    assert channel.next_deadline(CLOCK) == CLOCK + READS_RETRY_NANOS
    collected = channel.counters(CLOCK).collected["consumption"]
    looked.slices, before = 0, channel.freed_entries
    assert put(channel, CLOCK + 1).run is not None
    assert channel.freed_entries - before <= BACKLOG_ENTRIES_MAX + SLICES_CONSUMED_MAX + 1
    assert looked.slices <= 2 * (BACKLOG_ENTRIES_MAX + SLICES_CONSUMED_MAX) + 64
    assert SLICES_CONSUMED_MAX < collected < ITEMS
    for read in reads:
        assert sum(part.items for part in pieces.run_to_end(read).slices) == ITEMS
    channel.consume(1, [channel.next_seq - 1], CLOCK)
    later = CLOCK + READS_RETRY_NANOS
    while channel.next_deadline(later) == later:
        channel.collect(later)
    assert channel.counters(later).held == 1, "the newest item stays, because no consumer has consumed it"
