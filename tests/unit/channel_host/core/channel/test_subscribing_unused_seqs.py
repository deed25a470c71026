"""An owner that follows a lost one leaves out seqs. No count of missing items may have these seqs in it."""

from __future__ import annotations

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.seq_starts import start_of
from stampede_rt.values.timeline import Bound
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    ChannelFeed,
    FedChannel,
    Offer,
    Position,
    SubscriptionBatch,
    make_run,
)
from stampede_rt_channel_host.core.dedup import RetryWindow

CLOCK, INCARNATION = 200, 5


def owner(collected: int = 0) -> ChannelCore:
    """Has three items of a former owner, and four items of its own, without the first `collected` items."""
    channel = ChannelCore(Policy(), incarnation=INCARNATION)
    runs = [make_run(seq, [seq], None, [8], b"former") for seq in (1, 2, 3)]
    channel.restore(runs, after=None, next_seq=start_of(2), loss=(None, 50))
    offer = Offer(times=[100, 101, 102, 103], durations=None, lengths=[8] * 4)
    channel.put(offer, CLOCK, lambda first_seq, kept, stamped: b"own")
    if collected:
        channel.configure(Policy(max_items=7 - collected), CLOCK)
    return channel


def copy_of(source: ChannelCore) -> FedChannel:
    copy = FedChannel(Policy(), incarnation=INCARNATION)
    feed = ChannelFeed(source, None, CLOCK)
    while (part := feed.take(CLOCK, 100)) is not None:
        parts = part.slices
        copy.apply(
            first_seq=part.first_seq,
            cleared=part.cleared,
            runs=[make_run(one.first_seq, one.run.times[one.lo : one.hi], None, [8] * one.items, b"") for one in parts],
            next_seq=part.next_seq,
            collection=part.collection,
            advance=part.advance,
            now=CLOCK,
        )
    feed.close()
    return copy


@pytest.mark.parametrize(("collected", "missed"), [(0, 0), (5, 2)])
def test_a_copy_counts_only_seqs_of_items_as_missed(collected: int, missed: int) -> None:
    source = owner(collected)
    copy = copy_of(source)
    assert (copy.next_seq, copy.missed, source.missed) == (start_of(2) + 4, missed, 0)
    assert copy.counters(CLOCK).held == 7 - collected
    second_copy = copy_of(FedChannel.of_owner(owner(collected), RetryWindow(), CLOCK))
    assert (second_copy.next_seq, second_copy.missed) == (copy.next_seq, missed)


def batches(channel: ChannelCore) -> list[SubscriptionBatch]:
    cursor = channel.subscribe_all(CLOCK, after=Position(2, 2, INCARNATION))
    found = []
    while not (batch := channel.since(cursor, CLOCK, 10**6)).is_empty:
        found.append(batch)
    assert cursor.dropped == sum(one.gap.items for one in found if one.gap is not None)
    return found


@pytest.mark.parametrize("is_copy", [False, True])
def test_a_reader_gets_no_gap_for_seqs_that_no_item_has(is_copy: bool) -> None:
    source = owner()
    whole = batches(copy_of(source) if is_copy else source)
    assert [seq for one in whole for part in one.slices for seq in range(part.slice.first_seq, part.slice.end_seq)] == [
        3, *range(start_of(2), start_of(2) + 4)
    ]  # fmt: skip
    assert not [one.gap for one in whole if one.gap is not None]
    partial = batches(copy_of(owner(5)) if is_copy else owner(5))
    (gap,) = [one.gap for one in partial if one.gap is not None]
    assert (gap.first_seq, gap.last_seq, gap.items) == (start_of(2), start_of(2) + 1, 2)


def test_a_reader_of_the_newest_item_skips_no_seqs_that_no_item_has() -> None:
    channel = owner()
    cursor = channel.subscribe_newest(CLOCK, after=Position(2, 2, INCARNATION))
    assert channel.latest(cursor, CLOCK) is not None
    assert cursor.skipped == 3
    whole = channel.subscribe_newest(CLOCK, start=Bound(None, 0))
    assert whole.saved(INCARNATION).next_seq == start_of(2) - 3
    assert channel.latest(whole, CLOCK) is not None
    assert whole.skipped == 6
