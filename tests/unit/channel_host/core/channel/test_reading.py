"""Reads and blocking reads, in the words of the time model."""

from __future__ import annotations

import pytest

from stampede_rt.errors import IncarnationLost, InvalidArgument
from stampede_rt.values.model import Policy, Reason
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    NEWEST,
    NOW,
    OLDEST,
    Bound,
    Interval,
    Match,
    parse_interval,
)
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    Needs,
    PendingGet,
    Position,
    Query,
    Reach,
    ReachTracker,
    ReadAnswer,
    WakeAt,
    pieces,
)
from tests.support.channel_host.channel_cores import CLOCK, a_channel, get, put, seqs_of, times_of


def test_at_finds_the_item_whose_span_contains_the_instant() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, 30, durations=[5, -1, -1])
    assert times_of(get(channel, 14, 14).slices) == [10]
    assert times_of(get(channel, 15, 15).slices) == []
    assert times_of(get(channel, 29, 29).slices) == [20]
    assert times_of(get(channel, CLOCK, CLOCK).slices) == [30]
    assert times_of(get(channel, CLOCK + 1, CLOCK + 1).slices) == []


def test_time_is_continuous_between_two_neighbouring_nanoseconds() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 11)
    assert times_of(get(channel, 10, 11, "()").slices) == [10]
    assert times_of(get(channel, 10, 10, "[)").slices) == []


def test_the_span_of_an_item_without_a_duration_can_be_one_instant() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, durations=[0, 0])
    assert times_of(get(channel, 10, 20, "()").slices) == []
    assert times_of(get(channel, 10, 20, "[)").slices) == [10]


def test_adjoining_half_open_intervals_return_each_item_once_by_start() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, 30)
    parts = [get(channel, start, start + 10, "[)", match=Match.START) for start in (5, 15, 25)]
    assert [times_of(part.slices) for part in parts] == [[10], [20], [30]]
    assert times_of(get(channel, 30, NOW, "(]", match=Match.START).slices) == []


def test_match_whole_needs_the_whole_span_and_the_span_of_the_newest_item_ends_now() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, 30)
    assert times_of(get(channel, 10, 29, match=Match.WHOLE).slices) == [10]
    assert times_of(get(channel, 10, 30, match=Match.WHOLE).slices) == [10, 20]
    assert times_of(get(channel, 10, NOW, match=Match.WHOLE).slices) == [10, 20, 30]
    assert times_of(get(channel, 10, NOW - "1ns", match=Match.WHOLE).slices) == [10, 20]


def test_now_is_never_before_the_newest_item() -> None:
    channel = a_channel(max_items=9)
    put(channel, CLOCK + 100)
    answer = get(channel, OLDEST, NOW)
    assert times_of(answer.slices) == [CLOCK + 100]
    assert answer.interval is not None
    assert answer.interval.end == CLOCK + 100


def test_the_next_time_behind_an_answer_ends_its_last_bucket() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 20, 20, 30)
    assert get(channel, 10, 15).next_time == 20
    assert get(channel, 10, 20).next_time == 30
    assert get(channel, 10, 30).next_time is None
    assert get(channel, 20, 25, limit=1).next_time == 30


@pytest.mark.parametrize("newest_first", [False, True])
@pytest.mark.parametrize("steps", [1, 1000])
def test_with_overlap_an_answer_names_the_next_bucket_that_it_leaves_out(
    monkeypatch: pytest.MonkeyPatch, newest_first: bool, steps: int
) -> None:
    monkeypatch.setattr(pieces, "STEPS_PER_PIECE", steps)
    channel = a_channel(max_items=9, overlap_nanos=9)
    for time, duration in ((0, 1), (5, -1), (15, 9), (16, 1), (17, 1), (30, -1)):
        put(channel, time, durations=[duration])
    answer = get(channel, 0, 20, match=Match.WHOLE, newest_first=newest_first)
    assert times_of(answer.slices) == [0, 5, 16, 17]
    assert (answer.next_times, answer.next_time) == ({(5, 3): 15}, 30)


def test_the_lowest_seq_of_a_bucket_comes_first_or_with_newest_first_the_highest() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, 10, 10)
    assert seqs_of(get(channel, match=Match.START, limit=1).slices) == [1]
    assert seqs_of(get(channel, match=Match.START, limit=1, newest_first=True).slices) == [3]


@pytest.mark.parametrize("newest_first", [False, True])
def test_pages_with_after_return_every_item_once(newest_first: bool) -> None:
    channel = a_channel(max_items=99)
    put(channel, 10, 20, 20, 20, 15, 30)
    seen: list[int] = []
    after, more = None, True
    while more:
        query = Query(
            interval=parse_interval(MIN_INSTANT, MAX_INSTANT), limit=2, newest_first=newest_first, after=after
        )
        answer = channel.read(query, CLOCK)
        page = list(zip(times_of(answer.slices), seqs_of(answer.slices), strict=True))
        seen += [seq for _, seq in (page[::-1] if newest_first else page)]
        time, seq = page[0] if newest_first else page[-1]
        after, more = Position(time, seq), answer.more
    assert seen == ([6, 4, 3, 2, 5, 1] if newest_first else [1, 5, 2, 3, 4, 6])


def test_an_empty_answer_has_the_reason_collected_never_or_not_yet() -> None:
    channel = a_channel(max_items=2)
    assert get(channel, OLDEST, NOW).reason == "NOT_YET"
    assert get(channel, OLDEST, NOW).interval is None
    put(channel, 10, 20, 40, durations=[5, 5, 5])
    assert get(channel, 5, 14).reason == "COLLECTED"
    assert get(channel, 26, 39).reason == "NEVER"
    assert get(channel, 46, 60).reason == "NOT_YET"
    assert get(channel, NEWEST, OLDEST).reason == "NEVER", "meta-times may cross; then nothing lies between"


def test_an_advance_finishes_the_intervals_before_it() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, durations=[5])
    channel.advance(50, CLOCK)
    assert get(channel, 20, 50).reason == "NOT_YET"
    assert get(channel, 20, 50, "[)").reason == "NEVER"
    assert get(channel, 20, 50, "[)").complete


def test_a_partial_answer_is_truncated_by_the_collecting_policy() -> None:
    channel = a_channel(max_items=2)
    put(channel, 10, 20, 30)
    answer = get(channel, 5, 30)
    assert answer.truncated
    assert answer.reason == "COLLECTED"
    assert get(channel, 20, 30).reason is None


def test_a_position_of_another_incarnation_is_refused() -> None:
    channel = a_channel(max_items=9)
    query = Query(interval=parse_interval(MIN_INSTANT, NOW), after=Position(10, 1, incarnation=4))
    with pytest.raises(IncarnationLost, match="incarnation 4, and the channel is incarnation 3"):
        channel.read(query, CLOCK)
    with pytest.raises(InvalidArgument, match="limit is 0"):
        Query(interval=parse_interval(MIN_INSTANT, NOW), limit=0)


def instant_to_wake(channel: ChannelCore, pending: PendingGet) -> int | None:
    found = channel.poll(pending, CLOCK)
    assert isinstance(found, WakeAt)
    return found.instant


def test_a_blocking_get_resolves_its_anchors_at_the_first_item_and_never_again() -> None:
    channel = a_channel(max_items=9)
    pending = channel.begin(Query(interval=Interval(NEWEST, Bound(None, 35)), complete=True), CLOCK)
    assert instant_to_wake(channel, pending) is None
    put(channel, 10)
    assert instant_to_wake(channel, pending) is None
    put(channel, 30, 40)
    answer = channel.poll(pending, CLOCK)
    assert isinstance(answer, ReadAnswer)
    assert answer.interval is not None
    assert answer.interval.start == 10
    assert times_of(answer.slices) == [10, 30]


def test_a_blocked_get_states_the_change_that_can_release_it() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    expected = {
        (Match.SPAN, False): Needs(passed=CLOCK + 91, end=CLOCK + 50),
        (Match.START, False): Needs(passed=CLOCK + 91, time=CLOCK + 50),
        (Match.SPAN, True): Needs(passed=CLOCK + 91),
    }
    for (match, complete), needs in expected.items():
        query = Query(interval=parse_interval(CLOCK + 50, CLOCK + 90), match=match, complete=complete)
        found = channel.poll(channel.begin(query, CLOCK), CLOCK)
        assert isinstance(found, WakeAt)
        assert found.needs == needs


def test_the_extent_of_a_change_covers_all_its_items() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    tracker = ReachTracker(channel)
    tracker.begin()
    channel.advance(CLOCK + 60, CLOCK)
    assert tracker.reach(CLOCK) == Reach(passed=CLOCK + 60, time=None, end=None)
    put(channel, CLOCK + 60, durations=[500])
    assert tracker.reach(CLOCK) == Reach(passed=CLOCK + 60, time=CLOCK + 60, end=CLOCK + 560)
    assert tracker.reach(CLOCK) == Reach(passed=CLOCK + 60, time=None, end=None)


def test_items_that_a_group_hides_reach_no_reader_until_they_are_visible() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10, durations=[5])
    tracker = ReachTracker(channel)
    tracker.begin(cut=20)
    put(channel, 30, durations=[5])
    assert tracker.reach(CLOCK, cut=20) == Reach(passed=20, time=None, end=None)
    put(channel, 12, durations=[5])
    assert tracker.reach(CLOCK, cut=20) == Reach(passed=20, time=12, end=17)
    assert tracker.reach(CLOCK, cut=31) == Reach(passed=30, time=30, end=35)


def test_a_waiting_get_for_a_future_instant_is_tried_at_that_instant() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    pending = channel.begin(Query(interval=parse_interval(CLOCK + 50, CLOCK + 60, "(]")), CLOCK)
    assert instant_to_wake(channel, pending) == CLOCK + 51
    answer = channel.poll(pending, CLOCK + 51)
    assert isinstance(answer, ReadAnswer)
    assert times_of(answer.slices) == [10], "the newest item holds up to now"


def test_a_complete_get_returns_the_found_items_when_it_is_given_up() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    pending = channel.begin(Query(interval=parse_interval(10, 20), complete=True), CLOCK)
    assert isinstance(channel.poll(pending, CLOCK), WakeAt)
    answer = channel.give_up(pending, CLOCK)
    assert times_of(answer.slices) == [10]
    assert (answer.complete, answer.reason) == (False, "NOT_YET")


def test_a_blocking_get_below_the_frontier_answers_collected_immediately() -> None:
    channel = a_channel(max_items=1)
    put(channel, 10, 50)
    pending = channel.begin(Query(interval=parse_interval(10, 20)), CLOCK)
    answer = channel.poll(pending, CLOCK)
    assert isinstance(answer, ReadAnswer)
    assert answer.reason == "COLLECTED"


def test_newest_after_an_instant_waits_for_a_later_one() -> None:
    channel = a_channel(max_items=9)
    put(channel, 10)
    everything = parse_interval(MIN_INSTANT, MAX_INSTANT)
    query = Query(interval=everything, match=Match.START, limit=1, newest_first=True, newer_than=Position(10))
    pending = channel.begin(query, CLOCK)
    put(channel, 10, 5)
    assert isinstance(channel.poll(pending, CLOCK), WakeAt)
    put(channel, 11)
    answer = channel.poll(pending, CLOCK)
    assert isinstance(answer, ReadAnswer)
    assert times_of(answer.slices) == [11]


def test_a_read_of_items_of_an_earlier_incarnation_has_the_reason_lost() -> None:
    """In an earlier version, the answer said that nobody had put an item there."""
    channel = ChannelCore(Policy(max_items=9), incarnation=0xABC, lost_before=CLOCK)
    before = get(channel, CLOCK - 20, CLOCK - 10)
    assert (before.reason, before.complete, before.truncated) == ("LOST", False, True)
    assert "incarnation abc began then" in (before.reason.detail if before.reason else "")
    assert get(channel, CLOCK - 20, CLOCK + 10).reason == "LOST"
    assert get(channel, CLOCK, CLOCK + 10).reason == "NOT_YET"
    unresolved = get(channel, OLDEST, NEWEST).reason or Reason("NEVER", "")
    assert unresolved == "LOST"
    assert "was lost" in unresolved.detail
    put(channel, CLOCK + 5, now=CLOCK + 5)
    assert get(channel, CLOCK - 20, CLOCK - 10, now=CLOCK + 5).reason == "LOST"
    partial = get(channel, CLOCK - 20, CLOCK + 5, now=CLOCK + 5)
    assert (times_of(partial.slices), partial.reason, partial.truncated) == ([CLOCK + 5], "LOST", True)
    assert get(channel, CLOCK + 1, CLOCK + 2, now=CLOCK + 5).reason == "NEVER"
    assert get(channel, CLOCK, CLOCK + 5, now=CLOCK + 5).reason is None


def test_a_lost_item_that_is_put_again_releases_the_gets_that_wait_for_it() -> None:
    channel = ChannelCore(Policy(max_items=9), incarnation=2, lost_before=CLOCK)
    pending = channel.begin(Query(interval=parse_interval(CLOCK - 20, CLOCK - 10)), CLOCK)
    assert isinstance(channel.poll(pending, CLOCK), WakeAt)
    put(channel, CLOCK - 15)
    answer = channel.poll(pending, CLOCK)
    assert isinstance(answer, ReadAnswer)
    assert times_of(answer.slices) == [CLOCK - 15]


def test_the_reason_for_items_that_only_an_archive_can_have_names_no_limit_of_memory() -> None:
    channel = a_channel(max_items=9)
    channel.restore((), after=CLOCK - 100, next_seq=5, loss=(None, None))
    put(channel, CLOCK)
    reason = get(channel, CLOCK - 1000, CLOCK).reason
    assert reason == "COLLECTED"
    assert reason.detail.startswith("the read reaches back only to 1970-01-01T00:00:00.000999901Z: the limits")
