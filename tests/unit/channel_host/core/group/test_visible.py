"""The items of a channel that a group shows, and why it shows no more."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.errors import IncarnationLost
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NEWEST, NOW, OLDEST, parse_interval
from stampede_rt_channel_host.core.channel import Needs, Offer, Position, Query, WakeAt
from stampede_rt_channel_host.core.group import Horizon, VisibleAllCursor, VisibleChannel, VisibleNewestCursor
from tests.support.channel_host.group_channels import INCARNATION, channel, put, times
from tests.support.channel_host.group_channels import NOW as CLOCK


def horizon(cut: int | None) -> Horizon:
    return Horizon(cut, lambda: "held back by channel text")


def everything() -> Query:
    return Query(interval=parse_interval(OLDEST, NEWEST))


def test_only_items_before_the_cut_are_visible_and_the_channel_keeps_the_others() -> None:
    made = channel(10, 20, 30)
    view = VisibleChannel(made)
    answer = view.read(everything(), horizon(30), CLOCK)
    assert times(answer.slices) == [10, 20]
    assert answer.next_time is None  # the next item is hidden, so its time is hidden, too
    assert times(made.read(everything(), CLOCK).slices) == [10, 20, 30]
    assert view.hidden_items(30, CLOCK) == 1


def test_an_answer_that_the_cut_leaves_empty_names_the_member_that_holds_the_cut_back() -> None:
    answer = VisibleChannel(channel(10, 20)).read(Query(interval=parse_interval(20, 25)), horizon(15), CLOCK)
    assert answer.reason == "HIDDEN"
    assert answer.reason is not None
    assert "held back by channel text" in answer.reason.detail


def test_the_clock_stops_at_the_cut() -> None:
    view = VisibleChannel(channel(10, 20))
    answer = view.read(Query(interval=parse_interval(NOW - "5ns", NOW)), horizon(18), CLOCK)
    assert answer.interval is not None
    assert (answer.interval.start, answer.interval.end) == (13, 18)
    assert times(answer.slices) == [10]  # its span lasts up to now, because no later item is visible


def test_without_a_cut_no_item_is_visible_and_now_has_no_instant() -> None:
    view = VisibleChannel(channel(10))
    assert view.read(everything(), horizon(None), CLOCK).reason == "HIDDEN"
    assert view.read(Query(interval=parse_interval(5, NOW)), horizon(None), CLOCK).interval is None
    assert VisibleChannel(channel()).read(everything(), horizon(None), CLOCK).reason == "NOT_YET"


def test_a_complete_get_also_waits_for_the_cut() -> None:
    view = VisibleChannel(channel(10, 20, 30))
    query = Query(interval=parse_interval(5, 25, "[)"), complete=True)
    pending = view.begin(query, horizon(22), CLOCK)
    assert view.poll(pending, horizon(22), CLOCK) == WakeAt(None, Needs(passed=25))
    answer = view.poll(pending, horizon(25), CLOCK)
    assert not isinstance(answer, WakeAt)
    assert answer.complete
    assert times(answer.slices) == [10, 20]


def test_a_reader_that_has_seen_a_later_cut_learns_that_the_host_is_stalled() -> None:
    answer = VisibleChannel(channel(10)).stalled(40, horizon(5))
    assert (answer.slices, answer.reason, answer.complete) == ((), "HIDDEN", False)


def test_a_read_reports_a_max_age_shorter_than_the_lead_over_the_cut() -> None:
    view = VisibleChannel(channel(10, 5_000, policy=Policy(max_age_nanos=4_000)))
    assert view.window_too_short(20, 5_001)
    assert not view.window_too_short(1_500, 5_001)
    assert not view.window_too_short(1_000, 5_001)  # the channel is 4000 ahead of the cut, and keeps items for 4000


def test_an_item_that_was_collected_at_or_after_the_cut_shows_that_retention_is_too_short() -> None:
    view = VisibleChannel(channel(10, 20, 30, policy=Policy(max_items=1)))
    assert view.window_too_short(None, CLOCK)
    assert view.window_too_short(20, CLOCK)
    assert not view.window_too_short(21, CLOCK)


def test_positions_of_another_incarnation_are_refused() -> None:
    query = Query(interval=parse_interval(OLDEST, NEWEST), after=Position(10, 1, INCARNATION + 1))
    with pytest.raises(IncarnationLost):
        VisibleChannel(channel(10)).read(query, horizon(15), CLOCK)


def delivered(reader: VisibleAllCursor, cut: int | None) -> list[int]:
    found: list[int] = []
    while (part := reader.take(horizon(cut), CLOCK, 100)).more or not part.is_empty:
        found += times([one.slice for one in part.slices])
    return found


def test_a_subscription_brings_newly_visible_items_and_late_items() -> None:
    made = channel(10, 20, 30)
    reader = VisibleAllCursor(made, horizon(20), CLOCK)
    assert delivered(reader, 20) == []
    put(made, 15)
    assert delivered(reader, 20) == [15]
    assert delivered(reader, 31) == [20, 30]


def test_a_subscription_with_a_start_begins_with_the_visible_items_from_the_start_on() -> None:
    made = channel(10, 20, 30)
    reader = VisibleAllCursor(made, horizon(25), CLOCK, start=OLDEST, start_exclusive=True)
    assert delivered(reader, 25) == [20]
    assert delivered(reader, 40) == [30]


def test_a_resumed_group_subscription_skips_nothing() -> None:
    made = channel(10, 20, 30, 15)  # the last item came late
    reader = VisibleAllCursor(made, horizon(40), CLOCK, after=Position(20, 2, INCARNATION))
    assert delivered(reader, 40) == [15, 30]


def test_a_subscription_resumed_within_a_step_skips_no_late_item() -> None:
    """The item at 5 was readable before the item at 20. It also comes first, because the item at 20 has the higher
    seq.
    """
    made = channel(10)
    reader = VisibleAllCursor(made, horizon(15), CLOCK)
    put(made, 5)
    put(made, 20)
    first = times([one.slice for one in reader.take(horizon(25), CLOCK, 1).slices])
    assert first == [5]
    resumed = VisibleAllCursor(made, horizon(25), CLOCK, after=Position(5, 2, INCARNATION))
    assert delivered(resumed, 25)[-1] == 20


def test_a_subscription_resumed_within_a_run_keeps_all_granted_items() -> None:
    """In an earlier version, the items after the key in the same run counted twice.

    The subscription then reported them as lost.
    """
    made = channel(policy=Policy(max_items=3))
    made.put(Offer(times=[10, 20, 30], durations=None, lengths=[8] * 3), CLOCK, lambda first_seq, kept, stamped: b"")
    reader = VisibleAllCursor(made, horizon(15), CLOCK, after=Position(10, 1, INCARNATION))
    put(made, 40)
    put(made, 50)
    part = reader.take(horizon(60), CLOCK, 10**6)
    assert times([one.slice for one in part.slices]) == [30, 40, 50]
    gap = reader.take(horizon(60), CLOCK, 10**6).gap
    assert gap is not None
    assert gap.items == 1


def test_an_item_at_the_very_time_of_the_cut_is_hidden_from_a_caller_that_asks_for_it() -> None:
    view = VisibleChannel(channel(10, 20, 30, 30))
    assert times(view.read(Query(interval=parse_interval(5, 40)), horizon(30), CLOCK).slices) == [10, 20]
    assert times(view.read(Query(interval=parse_interval(5, 40)), horizon(31), CLOCK).slices) == [10, 20, 30, 30]


def test_items_that_the_cut_hides_beyond_the_limit_give_no_reason() -> None:
    view = VisibleChannel(channel(10, 20, 30))
    query = Query(interval=parse_interval(5, 40), limit=1)
    answer = view.read(query, horizon(25), CLOCK)
    assert (times(answer.slices), answer.more, answer.reason) == ([10], True, None)
    answer = view.read(replace(query, newest_first=True), horizon(25), CLOCK)
    assert (times(answer.slices), answer.more, answer.reason) == ([20], True, "HIDDEN")


def test_an_interval_that_includes_its_end_is_complete_when_the_cut_is_past_the_end() -> None:
    view = VisibleChannel(channel(10, 20, 30))
    query = Query(interval=parse_interval(5, 25, "[]"), complete=True)
    assert not view.read(query, horizon(25), CLOCK).complete
    assert view.read(query, horizon(26), CLOCK).complete


def test_a_get_from_a_future_instant_wakes_at_that_instant_unless_only_the_cut_can_release_it() -> None:
    view = VisibleChannel(channel(10))
    query = Query(interval=parse_interval(CLOCK + 5, CLOCK + 9))
    pending = view.begin(query, horizon(20), CLOCK)
    needs = Needs(passed=CLOCK + 10, end=CLOCK + 5)
    assert view.poll(pending, horizon(20), CLOCK) == WakeAt(None, needs)
    assert view.poll(pending, horizon(CLOCK + 5), CLOCK) == WakeAt(CLOCK + 5, needs)
    assert not isinstance(view.poll(pending, horizon(CLOCK + 6), CLOCK + 5), WakeAt)


def test_counting_from_a_key_without_an_item_is_exact() -> None:
    made = channel(policy=Policy(max_items=3))
    made.put(Offer(times=[10, 20, 30], durations=None, lengths=[8] * 3), CLOCK, lambda first_seq, kept, stamped: b"")
    reader = VisibleAllCursor(made, horizon(15), CLOCK, after=Position(5, 2, INCARNATION))
    put(made, 40)
    put(made, 50)
    assert times([one.slice for one in reader.take(horizon(60), CLOCK, 10**6).slices]) == [30, 40, 50]
    gap = reader.take(horizon(60), CLOCK, 10**6).gap
    assert gap is not None
    assert gap.items == 2


def test_the_lowest_owed_seq_of_a_subscription_is_the_seq_of_a_hidden_item() -> None:
    made = channel(10, 40, 20, 30)
    reader = VisibleAllCursor(made, horizon(15), CLOCK)
    assert reader.lowest_owed_seq(CLOCK) == 2
    assert delivered(reader, 35) == [20, 30]
    assert reader.lowest_owed_seq(CLOCK) == 2
    assert delivered(reader, 41) == [40]
    assert reader.lowest_owed_seq(CLOCK) == 5


def newest_time(reader: VisibleNewestCursor, cut: int) -> int | None:
    given = reader.take(horizon(cut), CLOCK)
    return given.slices[0].slice.first_time if given.slices else None


def test_a_newest_subscription_yields_the_newest_visible_item_and_counts_skipped_and_lost_items() -> None:
    made = channel(policy=Policy(max_items=2))
    reader = VisibleNewestCursor(made, horizon(5), CLOCK)
    for time in (10, 20, 30):
        put(made, time)
    assert newest_time(reader, 25) == 20
    assert newest_time(reader, 25) is None
    assert newest_time(reader, 31) == 30
    assert (reader.delivered, reader.skipped) == (2, 1)


def test_a_newest_subscription_begins_at_or_after_its_start() -> None:
    made = channel(10, 20)
    assert newest_time(VisibleNewestCursor(made, horizon(25), CLOCK, start=NEWEST), 25) == 20
    assert newest_time(VisibleNewestCursor(made, horizon(25), CLOCK, start=NEWEST, start_exclusive=True), 25) is None
    assert newest_time(VisibleNewestCursor(made, horizon(25), CLOCK), 25) is None


def test_a_newest_subscription_never_goes_back_although_later_items_are_consumed() -> None:
    made = channel(10, 20, policy=Policy(consumers=1, max_items=10))
    reader = VisibleNewestCursor(made, horizon(15), CLOCK)
    assert newest_time(reader, 25) == 20
    made.consume(1, [1, 2], CLOCK)
    put(made, 18)
    assert newest_time(reader, 25) is None
    assert reader.skipped == 1
