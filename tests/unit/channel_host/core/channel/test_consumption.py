"""Items that leave by consumption: places, leases, and the items that each place holds back."""

from __future__ import annotations

import pytest

from stampede_rt.errors import ChannelFull, InvalidArgument, Overloaded
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import (
    CONSUMED_RANGE_BYTES,
    CONSUMER_BYTES,
    LEASE_NANOS,
    SEQS_MAX,
    ChannelCore,
    consumer_places,
)
from tests.support.channel_host.channel_cores import CLOCK, a_channel, get, put, seqs_of, times_of

ANN, BOB, CYD = 11, 22, 33


def held(channel: ChannelCore, now: int = CLOCK) -> list[int]:
    return sorted(seqs_of(get(channel, now=now).slices))


def three_items(consumers: int = 2, **policy: int | str) -> ChannelCore:
    channel = a_channel(consumers=consumers, **policy)
    put(channel, 10, 20, 30)
    return channel


def test_an_item_is_collected_when_the_consumer_of_each_place_has_consumed_it() -> None:
    channel = three_items()
    assert channel.consume(ANN, [1, 2], CLOCK).items == 2
    assert held(channel) == [1, 2, 3], "one place was never taken, and holds all items"
    assert channel.consume(BOB, [1], CLOCK).items == 1
    assert held(channel) == [2, 3]
    assert channel.counters(CLOCK).collected["consumption"] == 1


def test_consuming_an_item_twice_has_the_same_effect_as_once() -> None:
    channel = three_items()
    assert channel.consume(ANN, [1, 2], CLOCK).items == 2
    assert channel.consume(ANN, [1, 2, 3, 3], CLOCK).items == 1
    assert held(channel) == [1, 2, 3], "one consumer counts once"


def test_an_item_is_kept_until_earlier_items_are_collected_so_that_no_span_grows() -> None:
    channel = three_items(consumers=1)
    channel.consume(ANN, [2, 3], CLOCK)
    assert times_of(get(channel, 25, 25).slices) == [20]
    channel.consume(ANN, [1], CLOCK)
    assert held(channel) == []


def test_the_refusal_of_a_consumer_beyond_the_places_names_the_time_at_which_a_place_becomes_free() -> None:
    channel = three_items()
    channel.consume(ANN, [], CLOCK)
    channel.consume(BOB, [], CLOCK)
    with pytest.raises(ChannelFull, match=r"counts 2 consumers and all places are taken.*10 s"):
        channel.consume(CYD, [1], CLOCK)
    assert held(channel) == [1, 2, 3]


def test_a_consumer_whose_lease_has_ended_holds_back_no_items_and_loses_its_place_to_the_next() -> None:
    channel = three_items()
    channel.consume(ANN, [1], CLOCK)
    channel.consume(BOB, [1, 2], CLOCK, lease_nanos=60 * 10**9)
    assert held(channel, CLOCK + LEASE_NANOS - 1) == [2, 3]
    assert channel.next_deadline(CLOCK + LEASE_NANOS - 1) == CLOCK + LEASE_NANOS
    assert held(channel, CLOCK + LEASE_NANOS) == [3]
    assert channel.consume(CYD, [], CLOCK + LEASE_NANOS).items == 0
    assert [place.consumer_id for place in channel.consumers(CLOCK + LEASE_NANOS)] == [CYD, BOB]


def test_a_consumer_that_takes_an_ended_place_starts_at_the_newest_item() -> None:
    channel = three_items()
    channel.consume(ANN, [], CLOCK, lease_nanos=5)
    channel.consume(BOB, [], CLOCK)
    channel.consume(CYD, [], CLOCK + 5)
    owed = {place.consumer_id: place.waiting for place in channel.consumers(CLOCK + 5)}
    assert owed == {BOB: 3, CYD: 1}


def test_a_consumer_that_returns_before_its_lease_ends_keeps_its_position() -> None:
    channel = three_items(consumers=1)
    channel.consume(ANN, [1], CLOCK)
    assert channel.consume(ANN, [2], CLOCK + LEASE_NANOS - 1).items == 1
    assert held(channel, CLOCK + LEASE_NANOS) == [3], "each consume renews the lease"


def test_a_new_consumer_gets_an_ended_place_before_an_unused_one() -> None:
    channel = three_items()
    channel.consume(ANN, [1], CLOCK, lease_nanos=5)
    channel.consume(BOB, [1, 2, 3], CLOCK + 5)
    assert held(channel, CLOCK + 5) == [1, 2, 3], "the second place was never taken"


def test_a_place_is_given_up_immediately_by_a_lease_of_zero() -> None:
    channel = three_items()
    channel.consume(ANN, [1, 2, 3], CLOCK)
    channel.consume(BOB, [1], CLOCK)
    channel.consume(BOB, [], CLOCK, lease_nanos=0)
    assert held(channel) == []


def test_a_consumer_without_a_place_that_gives_it_up_takes_none() -> None:
    channel = three_items()
    channel.consume(ANN, [], CLOCK, lease_nanos=0)
    assert channel.consumers(CLOCK) == []


def test_the_newest_bucket_is_kept_when_the_last_consumer_leaves() -> None:
    channel = three_items(consumers=1)
    channel.consume(ANN, [], CLOCK, lease_nanos=5)
    assert held(channel, CLOCK + 5) == [3]
    put(channel, 40, 40, now=CLOCK + 5)
    assert held(channel, CLOCK + 5) == [4, 5]


def test_a_blocked_put_fits_when_consumption_has_made_room_or_the_last_lease_has_ended() -> None:
    channel = three_items(consumers=1, max_items=3, on_full="block")
    channel.consume(ANN, [], CLOCK)
    waits = put(channel, 40)
    assert (waits.waiting, waits.retry_at) == (0, CLOCK + LEASE_NANOS)
    channel.consume(ANN, [1], CLOCK)
    assert put(channel, 40).waiting is None
    assert put(channel, 50).waiting == 0
    assert put(channel, 50, now=CLOCK + LEASE_NANOS).waiting is None
    assert held(channel, CLOCK + LEASE_NANOS) == [5]


def test_a_late_item_is_accepted_below_consumed_items() -> None:
    channel = three_items(consumers=1)
    channel.consume(ANN, [1, 2], CLOCK)
    assert put(channel, 5, 15).rejections == ()
    assert times_of(get(channel).slices) == [5, 15, 30]
    assert channel.frontier is None


def test_the_rest_of_a_bucket_keeps_the_order_of_seqs_when_a_late_item_arrives_before_it() -> None:
    """In an earlier version, a trimmed first entry of the bucket came after the others, and reads returned 7 to 12
    before 3 to 6.
    """
    channel = a_channel(consumers=1)
    put(channel, *[100] * 6)
    put(channel, *[100] * 6)
    channel.consume(ANN, [1, 2], CLOCK)
    put(channel, 99)
    assert seqs_of(get(channel, 100, 100).slices) == list(range(3, 13))
    channel.consume(ANN, [13, *range(3, 13)], CLOCK)
    assert (held(channel), channel.look(CLOCK)[0].backlog_bytes) == ([], 0)


def test_a_late_item_before_a_half_consumed_run_does_not_remove_the_other_half() -> None:
    channel = a_channel(consumers=1)
    put(channel, 10, 20, 30, 40)
    channel.consume(ANN, [1, 2], CLOCK)
    put(channel, 5, 15, 25)
    assert times_of(get(channel).slices) == [5, 15, 25, 30, 40]
    channel.consume(ANN, [5, 6, 7, 3], CLOCK)
    assert times_of(get(channel).slices) == [40]


def test_the_other_limits_also_collect_items_that_are_not_consumed() -> None:
    channel = three_items(consumers=1, max_items=3)
    put(channel, 40)
    counters = channel.counters(CLOCK)
    assert (counters.collected["count"], counters.collected["consumption"]) == (1, 0)
    assert channel.consume(ANN, [1, 2], CLOCK).items == 1, "the first item was gone"


def test_an_interval_is_still_finished_when_the_item_after_it_is_consumed() -> None:
    channel = three_items(consumers=1)
    assert get(channel, 21, 29).complete
    channel.consume(ANN, [1, 2, 3], CLOCK)
    answer = get(channel, 21, 29)
    assert (answer.complete, answer.reason) == (True, "NEVER")
    assert answer.reason is not None
    assert "consumed" in answer.reason.detail


def test_a_large_backlog_is_collected_in_small_parts() -> None:
    channel = a_channel(consumers=1)
    for time in range(8000):
        put(channel, time)
    for first in (2, 4001):
        channel.consume(ANN, range(first, min(first + 4000, 8001)), CLOCK)
    channel.consume(ANN, [1], CLOCK)
    assert channel.next_deadline(CLOCK) == CLOCK, "the channel has more to collect immediately"
    assert 0 < channel.counters(CLOCK).held < 8000
    while channel.next_deadline(CLOCK) == CLOCK:
        channel.collect(CLOCK)
    assert (channel.counters(CLOCK).held, channel.look(CLOCK)[0].backlog_bytes) == (0, 0)


def test_a_lower_number_of_consumers_removes_the_places_whose_leases_end_first() -> None:
    channel = three_items(consumers=3)
    channel.consume(ANN, [1, 2, 3], CLOCK, lease_nanos=300)
    channel.consume(BOB, [1], CLOCK, lease_nanos=100)
    channel.configure(Policy(consumers=1), CLOCK)
    assert held(channel) == []
    with pytest.raises(ChannelFull):
        channel.consume(BOB, [], CLOCK)


def test_added_places_hold_all_items_until_consumers_take_these_places() -> None:
    channel = three_items(consumers=1)
    channel.configure(Policy(consumers=2), CLOCK)
    channel.consume(ANN, [1, 2, 3], CLOCK)
    assert held(channel) == [1, 2, 3]
    channel.consume(BOB, [1, 2], CLOCK)
    assert held(channel) == [3]


def test_a_channel_in_use_can_get_consumers() -> None:
    channel = a_channel(max_items=4)
    put(channel, 10, 30, 20, 50, 40, 60)
    channel.configure(Policy(consumers=1), CLOCK)
    channel.consume(ANN, [2, 4, 5, 6], CLOCK)
    assert held(channel) == []


@pytest.mark.parametrize(
    ("consumer_id", "seqs", "message"),
    [
        (0, [1], "consumer_id is 0"),
        (ANN, [4], "seqs from 4 to 4.*next seq is 4"),
        (ANN, [0], "seqs from 0 to 0"),
        (ANN, [1] * (SEQS_MAX + 1), "4097 seqs"),
    ],
)
def test_an_impossible_consumption_is_refused_and_takes_no_place(
    consumer_id: int, seqs: list[int], message: str
) -> None:
    channel = three_items()
    with pytest.raises(InvalidArgument, match=message):
        channel.consume(consumer_id, seqs, CLOCK)
    assert channel.consumers(CLOCK) == []


def test_a_channel_without_consumers_refuses_consumption() -> None:
    channel = a_channel(max_items=4)
    put(channel, 10)
    with pytest.raises(InvalidArgument, match="counts no consumption"):
        channel.consume(ANN, [1], CLOCK)
    assert channel.look(CLOCK)[1].consumers is None


def test_consumer_places_can_be_exported_and_imported_as_values() -> None:
    channel, restored = three_items(), three_items()
    channel.consume(ANN, [1, 3], CLOCK)
    restored.restore_consumers(channel.consumer_places(CLOCK + 4), CLOCK + 4)
    assert restored.consumer_places(CLOCK + 4) == channel.consumer_places(CLOCK + 4)
    assert restored.consumers(CLOCK + 4) == channel.consumers(CLOCK + 4)
    restored.consume(BOB, [1, 2], CLOCK + 4)
    assert held(restored, CLOCK + 4) == [2, 3]


def test_the_window_follows_the_slowest_live_consumer_between_its_two_bounds() -> None:
    channel = a_channel(max_age_nanos=100, max_age_unconsumed_nanos=1000)
    put(channel, CLOCK, CLOCK + 10, CLOCK + 20)
    assert times_of(get(channel, now=CLOCK + 115).slices) == [CLOCK + 10, CLOCK + 20], "the channel has no consumer"
    channel.consume(ANN, [], CLOCK + 115)
    channel.consume(BOB, [2, 3], CLOCK + 115)
    put(channel, CLOCK + 30, now=CLOCK + 115)
    assert held(channel, CLOCK + 500) == [2, 3, 4], "one consumer lags"
    channel.consume(ANN, [2], CLOCK + 500)
    assert held(channel, CLOCK + 500) == [3, 4]
    assert held(channel, CLOCK + 1030) == [4], "the upper bound holds for all consumers"
    assert channel.counters(CLOCK + 1030).collected == {"age": 3, "count": 0, "bytes": 0, "consumption": 0}


def test_the_window_returns_to_its_lower_bound_when_the_slow_consumer_leaves() -> None:
    channel = a_channel(max_age_nanos=100, max_age_unconsumed_nanos=10**12)
    put(channel, CLOCK, CLOCK + 10)
    channel.consume(ANN, [], CLOCK)
    assert held(channel, CLOCK + LEASE_NANOS - 1) == [1, 2]
    assert held(channel, CLOCK + LEASE_NANOS) == [2]


def test_a_late_item_within_the_prolonged_window_is_accepted_and_an_older_one_is_not() -> None:
    channel = a_channel(max_age_nanos=100, max_age_unconsumed_nanos=1000)
    put(channel, CLOCK, durations=[0])
    assert [one.error.reason for one in put(channel, CLOCK - 500, durations=[0]).rejections] == ["TOO_OLD"]
    channel.consume(ANN, [], CLOCK)
    assert not put(channel, CLOCK - 500, durations=[0]).rejections
    assert [one.error.reason for one in put(channel, CLOCK - 1500, durations=[0]).rejections] == ["TOO_OLD"]


def test_a_future_interval_is_not_called_collected_after_the_last_item_was_consumed() -> None:
    """In an earlier version, the frontier moved years ahead if max_items collected an item of long duration and another
    item had the same time.
    """
    channel = a_channel(consumers=1, max_items=1)
    put(channel, 10, 10, durations=[10**15, 0])
    assert channel.frontier == 10
    channel.consume(ANN, [2], CLOCK)
    assert channel.frontier == 10
    found = get(channel, CLOCK + 5, CLOCK + 10)
    assert (found.complete, found.truncated, found.reason) == (False, False, "NOT_YET")


def test_with_a_thousand_consumers_a_put_or_consume_looks_at_few_of_them() -> None:
    """In an earlier version, with 1000 consumers a put took 1 ms, and a consume 1.6 ms."""
    channel = a_channel(consumers=1000)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    for consumer in range(1, 1001):
        channel.consume(consumer, [], CLOCK)
    looks = []
    for item in range(1, 31):
        before = retention.consumers.looked_at
        put(channel, CLOCK + item)
        looks.append(retention.consumers.looked_at - before)
        for place in range(1000):
            before = retention.consumers.looked_at
            channel.consume(1 + (place * 7 + item) % 1000, [item], CLOCK)
            looks.append(retention.consumers.looked_at - before)
    assert max(looks) <= 4
    assert held(channel) == []
    assert channel.counters(CLOCK).collected["consumption"] == 30


def test_the_consumption_of_one_slow_consumer_does_not_look_at_a_thousand_others() -> None:
    channel = a_channel(consumers=1000)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    put(channel, *range(CLOCK, CLOCK + 100))
    for consumer in range(2, 1001):
        channel.consume(consumer, range(1, 101), CLOCK)
    channel.consume(1, [], CLOCK)
    before = retention.consumers.looked_at
    for seq in range(1, 101):
        channel.consume(1, [seq], CLOCK)
        assert channel.counters(CLOCK).held == 100 - seq
    assert retention.consumers.looked_at - before <= 800


def test_no_consumer_owes_items_collected_by_age_and_a_put_does_not_visit_each_of_a_thousand() -> None:
    channel = a_channel(consumers=1000, max_age_nanos=100)
    _, retention = channel.look(CLOCK)
    assert retention.consumers is not None
    for consumer in range(1, 1001):
        channel.consume(consumer, [], CLOCK)
    before = retention.consumers.looked_at
    for item in range(200):
        put(channel, CLOCK + 10 * item, now=CLOCK + 10 * item)
    assert retention.consumers.looked_at - before <= 1000
    now = CLOCK + 1990
    held_now = held(channel, now)
    assert {place.waiting for place in channel.consumers(now)} == {len(held_now)}
    assert channel.consume(5, range(1, 201), now).items == len(held_now), "collected items count for no consumer"


def test_consumers_learn_of_collected_items_in_bounded_parts_and_of_all_before_they_consume() -> None:
    channel = a_channel(consumers=2)
    for time in range(5000):
        put(channel, CLOCK + time)
    channel.consume(1, [5000], CLOCK)
    channel.configure(Policy(consumers=2, max_items=10, max_future_nanos=10**6), CLOCK)
    held, _ = channel.look(CLOCK)
    assert held.items == 10
    assert held.report_gone(1), "the channel has more to report"
    assert held.index.has_below(held.floor), "items that consumers have not learned of are not freed"
    parts = 1 + sum(1 for _ in channel.catching_up(CLOCK))
    assert parts > 10
    assert channel.consume(1, [1, 4991], CLOCK).items == 1
    assert [one.waiting for one in channel.consumers(CLOCK)] == [8]


def test_seqs_consumed_out_of_order_count_as_memory_of_the_channel_as_long_as_it_keeps_them() -> None:
    """In an earlier version, no budget counted these seqs.

    30,000 separate seqs of each of 1024 consumers took 4 GB for 60,000 empty items.
    """
    channel = a_channel(consumers=2)
    put(channel, *range(10, 2010, 10))
    items = channel.footprint_bytes
    channel.consume(ANN, range(2, 200, 2), CLOCK)
    assert channel.footprint_bytes == items + CONSUMER_BYTES + 99 * CONSUMED_RANGE_BYTES
    channel.consume(BOB, range(2, 200, 2), CLOCK, lease_nanos=1)
    assert channel.footprint_bytes == items + 2 * (CONSUMER_BYTES + 99 * CONSUMED_RANGE_BYTES)
    channel.collect(CLOCK + 1)
    assert channel.footprint_bytes == items + 2 * CONSUMER_BYTES + 99 * CONSUMED_RANGE_BYTES, "a lease has ended"
    channel.consume(ANN, range(1, 199, 2), CLOCK + 1)
    assert channel.footprint_bytes == items + 2 * CONSUMER_BYTES, (
        "the consumed seqs are one range from the first seq on"
    )


def test_a_consumed_seq_beside_a_consumed_or_collected_seq_needs_no_memory() -> None:
    channel = a_channel(consumers=2)
    put(channel, *range(10, 2010, 10))
    assert channel.consumption_bytes(ANN, [1, 2, 3]) == CONSUMER_BYTES
    channel.consume(ANN, [1, 2, 3, 10], CLOCK)
    assert channel.consumption_bytes(ANN, [*range(4, 100)]) == 0
    assert channel.consumption_bytes(ANN, [9, 11]) == 0
    assert channel.consumption_bytes(ANN, [20, 22, 23, 40]) == 3 * CONSUMED_RANGE_BYTES
    assert channel.consumption_bytes(BOB, [20]) == CONSUMER_BYTES + CONSUMED_RANGE_BYTES


def test_one_caller_cannot_take_all_consumer_places(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consumer_places, "PLACES_OF_ONE_MAX", 2)
    channel = three_items(consumers=5)
    for consumer in (1, 2):
        channel.consume(consumer, [], CLOCK, caller_name="greedy")
    with pytest.raises(Overloaded, match=r"greedy has 2 of the channel's 5 consumer places, and 2 is the most for one"):
        channel.consume(3, [], CLOCK, caller_name="greedy")
    channel.consume(2, [1], CLOCK, caller_name="greedy")
    for consumer in (4, 5, 6):
        channel.consume(consumer, [], CLOCK)  # callers without a name of their own
    channel.consume(2, [], CLOCK, lease_nanos=0, caller_name="greedy")
    channel.consume(3, [], CLOCK, caller_name="greedy")
