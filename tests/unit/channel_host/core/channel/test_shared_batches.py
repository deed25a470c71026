"""Readers of a channel at the same place get the same batch, until the items change."""

from __future__ import annotations

from stampede_rt.values.timeline import parse_interval
from stampede_rt_channel_host.core.channel import AllCursor, ChannelCore
from stampede_rt_channel_host.core.channel.shared_batches import PLACES_MAX
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put, seqs_of

ENOUGH = 10**6
ITEM_BYTES = 10 + 64


def reader(channel: ChannelCore) -> AllCursor:
    return channel.subscribe_all(CLOCK, start=parse_interval(0, 0).start)


def taken(channel: ChannelCore, cursor: AllCursor, limit_bytes: int = ENOUGH, now: int = CLOCK) -> list[int]:
    return seqs_of([one.slice for one in channel.since(cursor, now, limit_bytes).slices])


def test_readers_at_the_same_position_share_one_batch_and_continue_after_it() -> None:
    channel = a_channel()
    put(channel, 1, 2)
    put(channel, 3)
    one, other = reader(channel), reader(channel)
    first = channel.since(one, CLOCK, ENOUGH)
    assert channel.since(other, CLOCK, ENOUGH // 2) is first
    assert seqs_of([part.slice for part in first.slices]) == [1, 2, 3]
    assert (other.delivered, other.next_seq) == (one.delivered, one.next_seq) == (3, 4)
    put(channel, 4)
    assert taken(channel, one) == taken(channel, other) == [4]


def test_a_reader_with_less_credit_gets_less() -> None:
    channel = a_channel()
    put(channel, 1, 2, 3)
    one, other, third = reader(channel), reader(channel), reader(channel)
    assert taken(channel, one) == [1, 2, 3]
    assert taken(channel, other, 1) == [1]
    assert taken(channel, third, ITEM_BYTES + 1) == [1, 2]
    assert taken(channel, other) == [2, 3]
    assert taken(channel, third) == [3]


def test_a_batch_that_a_limit_cut_off_is_for_readers_with_this_limit() -> None:
    channel = a_channel()
    put(channel, 1, 2)
    one, other, third = reader(channel), reader(channel), reader(channel)
    cut = channel.since(one, CLOCK, 1)
    assert channel.since(other, CLOCK, 1) is cut
    assert taken(channel, third) == [1, 2]


def test_an_item_that_changes_the_end_of_the_last_span_makes_a_new_batch() -> None:
    channel = a_channel()
    put(channel, 10)
    one, other = reader(channel), reader(channel)
    assert [part.next_time for part in channel.since(one, CLOCK, ENOUGH).slices] == [None]
    put(channel, 20)
    assert [part.next_time for part in channel.since(other, CLOCK, ENOUGH).slices] == [20, None]


def test_collected_items_are_in_no_shared_batch() -> None:
    channel = a_channel(max_age_nanos=100)
    put(channel, CLOCK, CLOCK + 50)
    one, other, third = reader(channel), reader(channel), reader(channel)
    assert taken(channel, one) == [1, 2]
    later = CLOCK + 160  # the first item's span ended at CLOCK + 50
    batch = channel.since(other, later, ENOUGH)
    assert batch.gap is not None
    assert (batch.gap.items, seqs_of([part.slice for part in batch.slices])) == (1, [2])
    assert (other.dropped, other.delivered) == (1, 1)
    assert taken(channel, third, now=later) == [2]
    assert third.dropped == 1


def test_a_channel_keeps_few_batches_and_none_of_former_items() -> None:
    channel = a_channel(max_items=100)
    readers = [reader(channel) for _ in range(20)]
    for place, cursor in enumerate(readers):
        put(channel, place + 1)
        taken(channel, cursor)
    put(channel, 21)
    assert channel._held.shared_batches is None
    for cursor in readers:
        taken(channel, cursor)
    kept = channel._held.shared_batches
    assert kept is not None
    assert len(kept._whole) + len(kept._cut) <= PLACES_MAX
