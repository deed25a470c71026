"""The moments at which items leave, by the rules of the time model. The collection of many items delays no caller."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NEWEST, NOW, OLDEST, Match
from stampede_rt_channel_host.core.channel import ChannelCore, ChannelFeed, Offer
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_blocks import BLOCK_ITEMS
from stampede_rt_channel_host.core.channel.run import Slice
from tests.support.channel_host.channel_cores import CLOCK, a_channel, get, put, times_of


def test_a_read_within_max_age_is_always_complete() -> None:
    channel = a_channel(max_age_nanos=100)
    put(channel, *range(CLOCK - 500, CLOCK, 30))
    answer = get(channel, NOW - "100ns", NOW)
    assert times_of(answer.slices)[0] <= CLOCK - 100
    assert not answer.truncated


def test_a_quiet_stream_keeps_its_newest_bucket() -> None:
    channel = a_channel(max_age_nanos=100)
    put(channel, CLOCK, CLOCK, durations=[5, 5])
    assert times_of(get(channel, now=CLOCK + 10**6, match=Match.START).slices) == [CLOCK, CLOCK]
    assert channel.next_deadline(CLOCK + 10**6) is None


def test_a_bucket_is_collected_as_a_whole_when_its_last_span_is_too_old() -> None:
    channel = a_channel(max_age_nanos=100)
    put(channel, CLOCK, CLOCK, CLOCK + 90, durations=[1, 60, -1])
    assert channel.next_deadline(CLOCK) == CLOCK + 160
    assert times_of(get(channel, now=CLOCK + 159, match=Match.START).slices) == [CLOCK, CLOCK, CLOCK + 90]
    assert times_of(get(channel, now=CLOCK + 160, match=Match.START).slices) == [CLOCK + 90]
    assert channel.frontier == CLOCK + 60
    assert channel.counters(CLOCK + 160).collected["age"] == 2


def test_max_items_and_max_bytes_collect_the_oldest_items_and_each_item_adds_64_bytes() -> None:
    by_count = a_channel(max_items=2)
    put(by_count, 10, 20, 30)
    assert times_of(get(by_count).slices) == [20, 30]
    by_bytes = a_channel(max_bytes=2 * (64 + 10))
    put(by_bytes, 10, 20, 30)
    assert times_of(get(by_bytes).slices) == [20, 30]
    assert by_bytes.counters(CLOCK).collected == {"age": 0, "count": 0, "bytes": 1, "consumption": 0}


def test_a_stricter_policy_collects_immediately_and_the_reason_names_its_limit() -> None:
    channel = a_channel(max_items=100)
    put(channel, *range(10, 100, 10))
    channel.configure(Policy(max_items=2), CLOCK)
    assert (channel.oldest, channel.frontier) == (80, 80)
    answer = get(channel, 10, 70)
    assert answer.reason == "COLLECTED"
    assert answer.reason is not None
    assert "max_items (2)" in answer.reason.detail


@pytest.mark.parametrize("duration", [0, 1, -1])
def test_a_read_of_the_instant_of_a_collected_item_says_collected_for_each_duration(duration: int) -> None:
    channel = a_channel(max_items=1)
    put(channel, 10, 20, durations=[duration, -1])
    answer = get(channel, 10, 10)
    assert (answer.reason, answer.truncated) == ("COLLECTED", True)
    assert get(channel, 11, 15).reason == ("COLLECTED" if duration < 0 else "NEVER")


def test_a_late_item_may_be_stored_between_collected_and_held_items() -> None:
    channel = a_channel(max_items=2)
    put(channel, 10, 20, 40)
    channel.configure(Policy(max_items=17), CLOCK)
    assert channel.frontier == 20
    put(channel, 15)
    assert channel.frontier == 15
    assert times_of(get(channel, 10, 19).slices) == [15]


def test_an_outdated_item_is_never_returned_though_its_memory_is_freed_in_small_parts() -> None:
    channel = a_channel(max_age_nanos=1000)
    for time in range(CLOCK, CLOCK + 500):
        put(channel, time, now=time)
    later = CLOCK + 100_000
    answer = get(channel, OLDEST, NEWEST, now=later)
    assert times_of(answer.slices) == [CLOCK + 499]
    assert channel.counters(later).collected["age"] == 499
    assert channel.next_deadline(later) == later
    assert channel.collect(later, entries_max=10), "there is more to free"
    assert not channel.collect(later, entries_max=10_000)
    assert channel.next_deadline(later) is None
    assert times_of(get(channel, now=later).slices) == [CLOCK + 499]


def test_collection_by_age_looks_at_a_bounded_number_of_items_in_each_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, the host stood still for most of a second if max_age collected a million items
    together.
    """
    channel = a_channel(max_age_nanos=1_000_000)
    for time in range(CLOCK, CLOCK + 9000):
        put(channel, time, now=time)
    looked = count_slices(monkeypatch)
    counters = channel.counters(CLOCK + 1_008_000)
    assert (counters.held, counters.held_bytes, counters.collected["age"]) == (1000, 10_000, 8000)
    assert (channel.oldest, channel.frontier) == (CLOCK + 8000, CLOCK + 8000)
    assert len(looked) <= BLOCK_ITEMS + 10


def count_slices(monkeypatch: pytest.MonkeyPatch) -> list[Slice]:
    """Count the slices that are read from now on."""
    looked: list[Slice] = []
    for name in ("slices", "slices_from"):
        found = getattr(ChannelIndex, name)

        def look(*places: object, found: Callable[..., Iterator[Slice]] = found) -> Iterator[Slice]:
            for part in found(*places):
                looked.append(part)
                yield part

        monkeypatch.setattr(ChannelIndex, name, look)
    return looked


def test_collection_by_age_counts_each_outdated_item_even_a_very_late_one() -> None:
    rng = random.Random(5)
    channel = a_channel(max_age_nanos=1_000_000, max_items=4500)
    held: list[int] = []
    now = CLOCK
    for step in range(1, 4001):
        now += 500 if step % 1000 else 900_000  # after this pause a few blocks are outdated together
        late = rng.choice((1, 1, 300_000))
        times = [now - rng.randrange(late) for _ in range(rng.randrange(1, 5))]
        put(channel, *times, now=now)
        held = sorted(held + times)
        past = [time for time in held if time <= now - 1_000_000]
        held = [time for time in held if not past or time >= past[-1]][-4500:]
        if step % 50 == 0:
            counters = channel.counters(now)
            assert (counters.held, counters.held_bytes, channel.oldest) == (len(held), 10 * len(held), held[0])


def test_outdated_items_are_freed_as_fast_as_puts_arrive() -> None:
    channel = a_channel(max_items=10)
    for first in range(0, 20_000, 20):
        put(channel, *range(first, first + 20))
        put(channel, *range(first + 1, first + 20, 2))
    assert not channel.collect(CLOCK, entries_max=100)


def test_one_large_item_that_outdates_many_small_ones_at_most_doubles_the_memory() -> None:
    channel = a_channel(max_bytes=64 * 1000)
    for time in range(1000):
        put(channel, time, lengths=[0])
    for time in range(1000, 1010):
        put(channel, time, lengths=[60_000])
    counters = channel.counters(CLOCK)
    assert (counters.held, counters.collected["bytes"]) == (1, 1009)
    assert not channel.collect(CLOCK, entries_max=1000)


def test_a_clock_ignores_an_earlier_time() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    assert get(channel, OLDEST, NOW, now=CLOCK + 5).interval.end == CLOCK + 5  # type: ignore[union-attr]
    assert get(channel, OLDEST, NOW, now=CLOCK).interval.end == CLOCK + 5  # type: ignore[union-attr]


def test_a_future_interval_is_not_called_collected_after_a_limit_took_the_last_item() -> None:
    channel = a_channel(max_items=1)
    put(channel, 10, durations=[10**15])
    channel.configure(Policy(max_bytes=64), CLOCK)
    assert channel.frontier == CLOCK
    assert get(channel, 10, CLOCK, "[)").reason == "COLLECTED"
    assert get(channel, CLOCK + 5, CLOCK + 10).reason == "NOT_YET"


def test_the_kept_part_of_a_run_is_copied_once_no_further_runs_come() -> None:
    cuts: list[tuple[int, int]] = []

    def cut(body: bytes, lo: int, hi: int) -> bytes:
        cuts.append((lo, hi))
        return bytes(10)

    channel = ChannelCore(Policy(max_items=17), incarnation=1, cut=cut)
    for number in range(8):  # the limit is not a multiple of the run: from the third put on, one item of a run is left
        now = CLOCK + number
        channel.put(Offer(times=None, durations=None, lengths=(1000,) * 8), now, lambda *_: bytes(8000))
    assert cuts == [(7, 8)], "only the third put has freed no whole run"
    full_bytes = channel.footprint_bytes
    feed = ChannelFeed(channel, None, CLOCK + 8)
    while feed.take(CLOCK + 8, 10**6) is not None:  # a reader comes in between two puts
        pass
    assert cuts == [(7, 8)]
    assert channel.next_deadline(CLOCK + 8) == CLOCK + 8
    channel.collect(CLOCK + 8)
    assert cuts == [(7, 8)] * 2
    assert channel.footprint_bytes == full_bytes - 7 * 64 - 8000 + 10
    assert channel.next_deadline(CLOCK + 8) is None
