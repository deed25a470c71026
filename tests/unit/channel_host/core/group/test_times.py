"""The progress of a channel, as its owner sees it and as the owner reports it to others."""

from __future__ import annotations

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT
from stampede_rt_channel_host.core.channel import ChannelCore, Offer
from stampede_rt_channel_host.core.group import ChannelTimes, OwnChannelTimes, TimesBoard
from tests.support.channel_host.group_channels import INCARNATION, NOW, channel, put

A = b"a"


def newest_times(of: ChannelCore, follower: OwnChannelTimes) -> tuple[int | None, int | None]:
    follower.observe(NOW)
    times = follower.times(1)
    assert times.incarnation == of.incarnation
    return times.newest, times.newest_end


def test_the_largest_end_in_the_newest_bucket_counts_and_a_later_bucket_has_its_own_end() -> None:
    made = channel(10, durations=[5])
    follower = OwnChannelTimes(made, NOW)
    assert newest_times(made, follower) == (10, 15)
    put(made, 10, 90)
    put(made, 10, 2)
    put(made, 10)
    assert newest_times(made, follower) == (10, 100)
    put(made, 20)
    assert newest_times(made, follower) == (20, None)
    put(made, 20, 0)
    assert newest_times(made, follower) == (20, 20)


def test_late_and_removed_items_change_no_time() -> None:
    made = channel(10, 30, durations=[5, 5], policy=Policy(max_items=2))
    follower = OwnChannelTimes(made, NOW)
    put(made, 20, 2**62)
    assert newest_times(made, follower) == (30, 35)
    put(made, 40)
    put(made, 50)
    assert made.oldest == 40
    assert newest_times(made, follower) == (50, None)


def test_a_run_is_looked_through_for_its_latest_bucket() -> None:
    made = channel()
    times, durations = [30, 10, 30, 20], [1, 500, 9, 500]
    made.put(Offer(times=times, durations=durations, lengths=[1] * 4), NOW, lambda first_seq, kept, stamped: b"")
    assert newest_times(made, OwnChannelTimes(made, NOW)) == (30, 39)


def test_an_endless_duration_ends_at_the_greatest_instant() -> None:
    made = channel(10, durations=[2**63 - 1])
    assert newest_times(made, OwnChannelTimes(made, NOW)) == (10, MAX_INSTANT)


def test_a_late_item_or_an_advance_ends_the_silence_of_a_channel_and_a_read_does_not() -> None:
    made = channel(10, 20)
    follower = OwnChannelTimes(made, 5)
    assert follower.observe(7) is False
    assert follower.silent_since == 5
    put(made, 15)
    assert follower.observe(8) is False  # no time changes, but the silence has ended
    assert follower.silent_since == 8
    made.advance(30, NOW)
    assert follower.observe(9) is True
    assert (follower.silent_since, follower.times(1).mark) == (9, 30)


def test_reports_of_one_incarnation_add_up_and_a_new_incarnation_replaces_them() -> None:
    board = TimesBoard()
    board.receive(A, ChannelTimes(1, INCARNATION, 50, 90, advance=10), 0, 0)
    board.enter_own(A, ChannelTimes(2, INCARNATION, 50, 60, advance=70), 0)  # the next owner holds less of the bucket
    assert _known(board) == ChannelTimes(2, INCARNATION, 50, 90, 70)
    board.receive(A, ChannelTimes(3, INCARNATION, 40, 99), 0, 0)
    assert _known(board) == ChannelTimes(3, INCARNATION, 50, 90, 70)
    board.receive(A, ChannelTimes(4, INCARNATION + 1, 20), 0, 0)
    assert _known(board) == ChannelTimes(4, INCARNATION + 1, 20)


def test_the_silence_of_a_channel_counts_up_to_the_last_report_of_its_host() -> None:
    board = TimesBoard()
    board.receive(A, ChannelTimes(1, INCARNATION, 50), silent_nanos=5, now=100)
    known = board.find(A)
    assert known is not None
    assert (known.silent_nanos(200), known.age_nanos(200)) == (5, 100)
    board.confirm([A, b"unheard of"], 150)
    assert (known.silent_nanos(200), known.age_nanos(200)) == (55, 50)
    board.enter_own(A, ChannelTimes(2, INCARNATION, 50), silent_since=160)
    known = board.find(A)
    assert known is not None
    assert (known.silent_nanos(200), known.age_nanos(200)) == (40, 0)
    board.disown(A, 210)
    assert (known.silent_nanos(300), known.age_nanos(300)) == (50, 90)
    board.forget(A)
    board.forget(A)
    assert board.find(A) is None


def test_a_time_is_passed_by_an_item_there_or_later_and_by_an_advance_beyond_it() -> None:
    assert ChannelTimes(1, 1, newest=50).has_passed(50)
    assert not ChannelTimes(1, 1, newest=49).has_passed(50)
    assert not ChannelTimes(1, 1, advance=50).has_passed(50)
    assert ChannelTimes(1, 1, advance=51).has_passed(50)


def _known(board: TimesBoard) -> ChannelTimes | None:
    known = board.find(A)
    return None if known is None else known.times
