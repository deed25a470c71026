"""Cut events: the moments at which they are due, and their contents."""

from __future__ import annotations

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, Offer
from stampede_rt_channel_host.core.group import (
    Boundary,
    CutFollower,
    CutMember,
    EventDecider,
    KnownTimes,
    OwnChannelTimes,
)
from stampede_rt_channel_host.core.group.deciding import PENDING_MAX
from stampede_rt_channel_host.core.group.times import ChannelTimes
from tests.support.channel_host.group_channels import INCARNATION, NOW, channel, put, times

WAIT = 100


def member(name: bytes, newest: int | None, *, idle: bool = False) -> CutMember:
    known = None if newest is None else KnownTimes(ChannelTimes(1, 1, newest), 0, None)
    return CutMember(name, known, newest, idle)


def test_an_event_is_due_when_every_member_has_reached_the_cut() -> None:
    decider = EventDecider(0, WAIT)
    decider.note(50, now=0)
    assert decider.due([member(b"a", 50), member(b"b", 40)], 0) is None
    assert decider.due([member(b"a", 60), member(b"b", 55)], 0) == Boundary(50)
    assert decider.wake_at() is None


def test_after_max_wait_the_event_is_sent_and_names_the_missing_members() -> None:
    decider = EventDecider(0, WAIT)
    decider.note(50, now=7)
    assert decider.wake_at() == 107
    assert decider.due([member(b"a", 50), member(b"b", None)], 107) == Boundary(50, (b"b",))


def test_an_event_waits_until_each_member_is_the_lateness_past_the_cut_or_has_advanced_to_it() -> None:
    decider = EventDecider(0, WAIT, 20)
    decider.note(50, now=7)
    assert decider.wake_at() == 127
    assert decider.due([member(b"a", 70), member(b"b", None)], 126) is None
    assert decider.due([member(b"a", 70), member(b"b", 69)], 126) == Boundary(49), "cut 50 waits"
    assert decider.due([member(b"a", 70), member(b"b", 69)], 126) is None
    advanced = CutMember(b"b", KnownTimes(ChannelTimes(1, 1, 40, advance=50), 0, None), 50, is_idle=False)
    assert decider.due([member(b"a", 70), advanced], 126) == Boundary(50)
    decider.note(60, now=8)
    assert decider.due([member(b"a", 80), member(b"b", 1)], 127) is None
    assert decider.due([member(b"a", 80), member(b"b", 1)], 128) == Boundary(60, (b"b",))


def test_an_event_does_not_wait_for_an_idle_member() -> None:
    decider = EventDecider(0, WAIT)
    decider.note(50, now=0)
    assert decider.due([member(b"a", 50), member(b"b", 1, idle=True)], 0) == Boundary(50, (b"b",))


def test_each_item_of_the_reference_makes_an_event_even_if_another_member_lags() -> None:
    decider = EventDecider(0, WAIT)
    for at in (10, 20, 30):
        decider.note(at, now=at)
    assert decider.due([member(b"text", 30), member(b"video", 15)], 30) == Boundary(10)
    assert decider.due([member(b"text", 30), member(b"video", 25)], 31) == Boundary(20)


def test_the_decider_merges_the_cuts_that_a_slow_reader_has_not_taken() -> None:
    decider = EventDecider(0, WAIT)
    for at in range(1, PENDING_MAX * 3):
        decider.note(at, now=0)
    assert decider.due([member(b"a", 10**6)], 0) == Boundary(PENDING_MAX * 3 - 1)


def test_an_event_has_fifteen_frames_for_each_text_item() -> None:
    """Figure 7 of the paper, with the frames' channel as a member and the text as the reference."""
    second, frame = 30_000_000, 2_000_000
    video, text = channel(), channel()
    follower = CutFollower(video, 0, NOW)
    decider, text_times, video_times = EventDecider(0, second), OwnChannelTimes(text, NOW), OwnChannelTimes(video, NOW)
    counts = []
    for number in range(1, 61):
        clock = number * frame
        offer_time = clock - 1
        put_at(video, offer_time, clock)
        if number % 15 == 0:
            put_at(text, offer_time, clock)
        text_times.observe(clock)
        video_times.observe(clock)
        newest = text_times.times(1).newest
        decider.note(newest, clock)
        due = decider.due([member(b"text", newest), member(b"video", video_times.times(1).newest)], clock)
        if due is not None:
            follower.begin(due.cut)
            counts.append(len(times([one.slice for one in follower.take(clock, 10**6).slices])))
    # A frame with the time of the text comes with the next event.
    assert counts == [
        14,
        15,
        15,
        15,
    ]


def put_at(into: ChannelCore, time: int, clock: int) -> None:
    into.put(Offer(times=[time], durations=None, lengths=[1]), clock, lambda first_seq, kept, stamped: b"")


def test_late_items_are_a_separate_part_of_the_next_event() -> None:
    made = channel(10, 20, 30)
    follower = CutFollower(made, 15, NOW)
    put(made, 12)
    follower.begin(25)
    step = follower.take(NOW, 10**6)
    assert (times([one.slice for one in step.slices]), times([one.slice for one in step.late])) == ([20], [12])
    assert step.is_last


def test_items_accepted_before_the_cut_of_an_unfinished_event_are_late_in_the_next_event() -> None:
    made = channel(10, 20, 30)
    follower = CutFollower(made, 0, NOW)
    follower.begin(25)
    first = follower.take(NOW, 1)
    put(made, 5)
    put(made, 22)
    rest = []
    while not (step := follower.take(NOW, 1)).is_last:
        rest += times([one.slice for one in step.slices + step.late])
    assert times([one.slice for one in first.slices]) + rest == [10, 20]
    follower.begin(31)
    step = follower.take(NOW, 10**6)
    assert times([one.slice for one in step.slices]) == [30]
    assert times([one.slice for one in step.late]) == [5, 22]


def test_the_event_counts_the_items_that_retention_collected_before_the_reader_got_them() -> None:
    made = channel(10, 20, policy=Policy(max_items=3))
    follower = CutFollower(made, 5, NOW)
    for time in (30, 40, 50):
        put(made, time)
    follower.begin(60)
    step = follower.take(NOW, 10**6)
    assert times([one.slice for one in step.slices]) == [30, 40, 50]
    assert step.loss is not None
    assert (step.loss.items, step.loss.is_exact, step.loss.before, step.loss.reason) == (2, True, 21, "COLLECTED")


def test_a_follower_continues_in_another_process_with_its_cut_and_seqs() -> None:
    made = channel(10, 20, 30)
    first = CutFollower(made, 0, NOW)
    first.begin(25)
    first.take(NOW, 10**6)
    put(made, 15)
    resumed = CutFollower(made, first.cut, NOW, next_seq=first.next_seq, incarnation=INCARNATION)
    resumed.begin(35)
    step = resumed.take(NOW, 10**6)
    assert (times([one.slice for one in step.slices]), times([one.slice for one in step.late])) == ([30], [15])
    assert step.loss is None


def test_a_follower_with_the_position_of_an_earlier_incarnation_reports_a_loss() -> None:
    made = channel(10, 20)
    follower = CutFollower(made, 15, NOW, next_seq=9, incarnation=INCARNATION + 1)
    follower.begin(25)
    step = follower.take(NOW, 10**6)
    assert (times([one.slice for one in step.slices]), times([one.slice for one in step.late])) == ([20], [10])
    assert step.loss is not None
    assert (step.loss.reason, step.loss.is_exact) == ("LOST", False)


def test_the_event_counts_the_items_that_all_consumers_consumed_before_the_reader_got_them() -> None:
    made = channel(10, 20, 30, policy=Policy(consumers=1, max_items=10))
    follower = CutFollower(made, 5, NOW)
    made.consume(1, [1, 2], NOW)
    follower.begin(25)
    step = follower.take(NOW, 10**6)
    assert step.loss is not None
    assert (step.loss.items, step.loss.before) == (2, 21)


def test_a_resumed_follower_reports_the_items_that_consumers_consumed_during_the_break() -> None:
    made = channel(10, 20, 30, policy=Policy(consumers=1, max_items=10))
    made.consume(1, [1, 2], NOW)
    follower = CutFollower(made, 15, NOW, next_seq=2, incarnation=INCARNATION)
    follower.begin(25)
    loss = follower.take(NOW, 10**6).loss
    assert loss is not None
    assert (loss.before, loss.is_exact) == (21, False)


def test_a_resumed_follower_also_reports_the_items_collected_before_its_first_take() -> None:
    made = channel(10, 20, 30, policy=Policy(max_items=2))
    follower = CutFollower(made, 5, NOW, next_seq=1, incarnation=INCARNATION)
    for time in (40, 50):
        put(made, time)
    follower.begin(60)
    loss = follower.take(NOW, 10**6).loss
    assert loss is not None
    assert (loss.before, loss.is_exact, loss.last_seq) == (31, False, 5)


def test_in_a_group_with_bound_end_an_event_waits_for_an_item_and_ignores_durations() -> None:
    """Durations may be wrong: if deciders trusted them, an item before the stated end would count as late."""
    until_133 = CutMember(b"a", KnownTimes(ChannelTimes(1, 1, 100, 133), 0, None), 133, False)
    decider = EventDecider(100, WAIT)
    decider.note(133, now=0)
    assert decider.due([until_133], 0) is None
    assert decider.due([until_133], WAIT) == Boundary(133, (b"a",))
    decider.note(166, now=WAIT)
    assert decider.due([member(b"a", 166)], WAIT) == Boundary(166)


def test_each_of_many_waiting_cuts_gets_its_event_when_its_own_max_wait_has_passed() -> None:
    """In an earlier version each further cut restarted the wait of merged cuts. Items came after up to twice `wait`."""
    wait, every = 1_000_000, 100
    decider, lagging = EventDecider(0, wait), [member(b"a", 10**9), member(b"b", 0)]
    cuts: list[int] = []
    for now in range(every, 3 * wait, every):
        decider.note(now, now)
        while (due := decider.due(lagging, now)) is not None:
            cuts.append(due.cut)
        assert len(decider._pending) <= PENDING_MAX
        assert (cuts[-1] if cuts else 0) >= now - wait - 2 * wait // PENDING_MAX - every
    assert len(cuts) > PENDING_MAX / 2


def test_only_a_visible_item_ends_the_span_of_an_earlier_item() -> None:
    made = channel(10, 20, 30)
    follower = CutFollower(made, 0, NOW)
    follower.begin(30)
    assert [one.next_time for one in follower.take(NOW, 10**6).slices] == [20, None]
    put(made, 15)
    follower.begin(31)
    step = follower.take(NOW, 10**6)
    assert ([one.next_time for one in step.late], [one.next_time for one in step.slices]) == ([20], [None])


def test_the_event_counts_consumed_items_even_if_a_late_item_comes_before_them() -> None:
    made = channel(10, 20, policy=Policy(consumers=1, max_items=10))
    follower = CutFollower(made, 5, NOW)
    made.consume(1, [1, 2], NOW)
    put(made, 7)
    follower.begin(25)
    step = follower.take(NOW, 10**6)
    assert times([one.slice for one in step.slices]) == [7]
    assert step.loss is not None
    assert step.loss.items == 2
