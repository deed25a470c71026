"""The puts that a channel accepts, by the rules of the time model."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from stampede_rt.errors import InFuture, InvalidArgument, MalformedRun, TooOld
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, PutOutcome
from tests.support.channel_host.channel_cores import CLOCK, a_channel, get, put, seal, times_of


def reasons(outcome_rejections: Sequence[object]) -> list[tuple[int, str]]:
    return [(one.index, one.error.reason) for one in outcome_rejections]  # type: ignore[attr-defined]


def test_a_run_without_times_is_stamped_with_the_later_of_clock_and_newest_item() -> None:
    channel = a_channel(max_items=9)
    unstamped = Offer(times=None, durations=None, lengths=[1, 1])
    assert channel.put(unstamped, CLOCK, seal).stamped_time == CLOCK
    put(channel, CLOCK + 500)
    outcome = channel.put(unstamped, CLOCK + 1, seal)
    assert outcome.stamped_time == CLOCK + 500
    assert outcome.run is not None
    assert outcome.run.body == f"4 None {CLOCK + 500}".encode()


def test_the_stamped_time_of_a_run_without_times_is_never_too_old() -> None:
    """In an earlier version, after an advance by a machine whose clock was 20 ms ahead, the puts of the next 20 ms were
    too old.
    """
    channel = a_channel(max_bytes=100)
    unstamped = Offer(times=None, durations=None, lengths=[1])
    channel.advance(CLOCK + 20, CLOCK)
    assert channel.put(unstamped, CLOCK + 1, seal).stamped_time == CLOCK + 20
    put(channel, CLOCK + 30)
    channel.configure(Policy(max_bytes=70), CLOCK + 2)
    assert channel.newest is None, "an item ahead of the clock was collected"
    assert channel.put(unstamped, CLOCK + 3, seal).stamped_time == CLOCK + 30


def test_refused_items_do_not_block_other_items_and_leave_no_hole_in_the_seqs() -> None:
    channel = a_channel(clock_ahead=100, max_items=9, max_item_bytes=50)
    outcome = put(channel, CLOCK, CLOCK + 101, CLOCK + 1, CLOCK + 2, lengths=[1, 1, 51, 1])
    assert reasons(outcome.rejections) == [(1, "IN_FUTURE"), (2, "ITEM_TOO_LARGE")]
    assert outcome.run is not None
    assert outcome.run.body == b"1 [0, 3] None"
    assert list(outcome.run.times) == [CLOCK, CLOCK + 2]
    assert channel.next_seq == 3


def test_the_error_of_an_item_too_far_ahead_has_the_measured_offset() -> None:
    channel = a_channel(clock_ahead=100, max_items=9)
    error = put(channel, CLOCK + 101).rejections[0].error
    assert isinstance(error, InFuture)
    assert "'cam/left'" in error.message
    assert error.metadata == {"offset_nanos": "101", "host_time_unix_nano": str(CLOCK)}


def test_the_error_of_an_item_without_a_time_blames_the_clock_of_the_host() -> None:
    channel = a_channel(clock_ahead=100, max_items=9)
    put(channel, CLOCK + 100)
    channel.configure(Policy(max_items=9, max_future_nanos=99), CLOCK)
    error = channel.put(Offer(times=None, durations=None, lengths=[1]), CLOCK, seal).rejections[0].error
    assert isinstance(error, InFuture)
    assert "the newest item or the advance of channel 'cam/left' is 100 ns ahead of the host's clock" in error.message
    assert "set the clock of the host's machine and start the host again" in error.message


def test_an_item_before_the_newest_collected_bucket_is_too_old_but_one_in_it_is_not() -> None:
    channel = a_channel(max_items=2)
    put(channel, 10, 10, 20)
    assert reasons(put(channel, 9).rejections) == [(0, "TOO_OLD")]
    assert put(channel, 10).run is not None
    assert times_of(get(channel).slices) == [10, 20]


def test_an_item_that_max_age_would_collect_immediately_is_too_old() -> None:
    channel = a_channel(max_age_nanos=100)
    put(channel, CLOCK - 50)
    assert put(channel, CLOCK - 500).run is not None, (
        "the item's span reaches to the next item, which is within the age"
    )
    short = put(channel, CLOCK - 300, durations=[200])
    assert reasons(short.rejections) == [(0, "TOO_OLD")]
    assert isinstance(short.rejections[0].error, TooOld)
    assert "max_age" in short.rejections[0].error.message


def test_an_old_item_in_an_empty_channel_is_its_newest_and_is_kept() -> None:
    channel = a_channel(max_age_nanos=100)
    assert put(channel, 5).run is not None
    assert channel.oldest == 5


def test_an_item_below_an_advance_is_too_old_and_one_at_it_is_not() -> None:
    channel = a_channel(max_items=9)
    assert channel.advance(50, CLOCK) == 50
    assert channel.advance(40, CLOCK) == 50
    assert reasons(put(channel, 49, 50).rejections) == [(0, "TOO_OLD")]


def test_an_advance_too_far_ahead_is_refused() -> None:
    channel = a_channel(clock_ahead=100, max_items=9)
    with pytest.raises(InFuture, match="max_future"):
        channel.advance(CLOCK + 101, CLOCK)
    assert channel.advanced_to is None


def test_the_refusal_of_a_full_channel_states_its_number_of_items_and_bytes() -> None:
    channel = a_channel(max_items=2, on_full="reject")
    outcome = put(channel, 10, 20, 30)
    assert reasons(outcome.rejections) == [(2, "CHANNEL_FULL")]
    assert "2 items" in outcome.rejections[0].error.message
    assert channel.counters(CLOCK).rejected["CHANNEL_FULL"] == 1


def test_a_put_into_a_full_blocking_channel_waits_until_max_age_would_collect_the_oldest_item() -> None:
    channel = a_channel(max_items=1, max_age_nanos=100, on_full="block")
    put(channel, CLOCK)
    waiting = put(channel, CLOCK + 10)
    assert (waiting.run, waiting.waiting, waiting.retry_at) == (None, 0, CLOCK + 10 + 100)
    assert put(channel, CLOCK + 10, now=CLOCK + 109).waiting == 0
    assert put(channel, CLOCK + 10, now=CLOCK + 110).run is not None
    assert times_of(get(channel, now=CLOCK + 110).slices) == [CLOCK + 10]


def test_the_part_of_a_run_that_fits_is_accepted_and_the_rest_waits() -> None:
    channel = a_channel(max_items=2, max_age_nanos=100, on_full="block")
    offer = Offer(times=[CLOCK, CLOCK + 1, CLOCK + 2, CLOCK + 3], durations=None, lengths=[1, 1, 1, 1])
    outcome = channel.put(offer, CLOCK, seal)
    assert outcome.run is not None
    assert outcome.run.body == b"1 [0, 1] None"
    assert outcome.waiting == 2
    given_up = channel.give_up_put(offer.rest(2, CLOCK))
    assert reasons(given_up.rejections) == [(0, "CHANNEL_FULL"), (1, "CHANNEL_FULL")]
    assert channel.counters(CLOCK).rejected["CHANNEL_FULL"] == 2


def test_a_put_into_the_newest_bucket_of_a_full_channel_has_no_retry_time() -> None:
    channel = a_channel(max_items=1, max_age_nanos=100, on_full="block")
    put(channel, CLOCK)
    assert put(channel, CLOCK).retry_at is None


def wait_untimed(channel: ChannelCore, since: int, now: int) -> PutOutcome:
    return channel.put(Offer(times=None, durations=None, lengths=[1], since=since), now, seal)


def test_a_put_without_a_time_waits_for_an_item_from_the_future() -> None:
    """In an earlier version, such a put counted as a part of the newest bucket, which never becomes too old.

    So the put waited for ever.
    """
    channel = a_channel(max_items=1, max_age_nanos=100, on_full="block")
    put(channel, CLOCK + 50)
    waiting = channel.put(Offer(times=None, durations=None, lengths=[1]), CLOCK, seal)
    assert (waiting.waiting, waiting.retry_at) == (0, CLOCK + 51 + 100)
    assert wait_untimed(channel, CLOCK, CLOCK + 150).waiting == 0
    assert wait_untimed(channel, CLOCK, CLOCK + 151).stamped_time == CLOCK + 151
    assert times_of(get(channel, now=CLOCK + 151).slices) == [CLOCK + 151]


def test_the_second_of_two_waiting_puts_waits_until_max_age_collects_the_first() -> None:
    """Both puts began to wait at the same instant.

    In an earlier version, when the first put had been accepted and had got its time, the second put waited for ever.
    """
    channel = a_channel(max_items=1, max_age_nanos=100, on_full="block")
    put(channel, CLOCK)
    first = wait_untimed(channel, CLOCK + 5, CLOCK + 5)
    assert first.retry_at == CLOCK + 105
    assert wait_untimed(channel, CLOCK + 5, CLOCK + 105).stamped_time == CLOCK + 105
    second = wait_untimed(channel, CLOCK + 5, CLOCK + 105)
    assert (second.waiting, second.retry_at) == (0, CLOCK + 206)
    assert wait_untimed(channel, CLOCK + 5, CLOCK + 206).stamped_time == CLOCK + 206


def test_the_rest_of_a_run_without_times_is_accepted_when_its_first_item_is_old_enough() -> None:
    channel = a_channel(max_items=1, max_age_nanos=100, on_full="block")
    offer = Offer(times=None, durations=None, lengths=[1, 1])
    outcome = channel.put(offer, CLOCK, seal)
    assert (outcome.stamped_time, outcome.waiting, outcome.retry_at) == (CLOCK, 1, CLOCK + 101)
    assert channel.put(offer.rest(1, CLOCK), CLOCK + 101, seal).stamped_time == CLOCK + 101


def test_a_waiting_put_without_consumers_is_accepted_after_the_clock_has_passed_the_newest_item() -> None:
    """The channel keeps its newest bucket for readers. A put into this bucket would exceed the limit."""
    channel = a_channel(max_items=1, consumers=1, on_full="block")
    put(channel, CLOCK + 50)
    channel.consume(1, [], CLOCK)
    channel.consume(1, [], CLOCK, lease_nanos=0)
    waiting = channel.put(Offer(times=None, durations=None, lengths=[1]), CLOCK, seal)
    assert (waiting.waiting, waiting.retry_at) == (0, CLOCK + 51)
    assert wait_untimed(channel, CLOCK, CLOCK + 50).waiting == 0
    assert wait_untimed(channel, CLOCK, CLOCK + 51).stamped_time == CLOCK + 51
    assert channel.counters(CLOCK + 51).held == 1


def test_a_put_beside_the_newest_item_of_a_full_channel_is_refused_immediately_if_nothing_can_make_room() -> None:
    """In an earlier version, the put waited until its timeout and blocked all later puts, because the newest bucket
    never becomes too old.
    """
    channel = a_channel(max_items=2, max_age_nanos=100, on_full="block")
    put(channel, CLOCK, CLOCK)
    refused = put(channel, CLOCK)
    assert refused.waiting is None
    (rejection,) = refused.rejections
    assert "put with a later time" in rejection.error.message
    assert put(channel, CLOCK + 1).retry_at == CLOCK + 101


def test_a_put_beside_the_newest_item_of_a_full_channel_waits_for_the_oldest_or_for_consumers() -> None:
    aging = a_channel(max_items=2, max_age_nanos=100, on_full="block")
    put(aging, CLOCK - 50, CLOCK)
    assert put(aging, CLOCK).retry_at == CLOCK + 100
    consumed = a_channel(max_items=1, consumers=1, on_full="block")
    put(consumed, CLOCK)
    assert put(consumed, CLOCK).waiting == 0


def test_a_malformed_offer_is_refused_by_its_columns() -> None:
    with pytest.raises(MalformedRun, match="no items"):
        Offer(times=[], durations=None, lengths=[])
    with pytest.raises(MalformedRun, match="2 lengths and 1 times"):
        Offer(times=[1], durations=None, lengths=[1, 1])


def test_puts_that_the_shell_refused_are_counted() -> None:
    channel = a_channel(max_items=9)
    channel.reject_malformed(3)
    assert channel.counters(CLOCK).rejected["MALFORMED_RUN"] == 3


def test_an_invalid_policy_is_refused_and_changes_nothing() -> None:
    channel = a_channel(max_items=9)
    before = channel.policy
    with pytest.raises(InvalidArgument):
        channel.configure(Policy(max_items=0), CLOCK)
    assert channel.policy is before
    with pytest.raises(InvalidArgument, match="consumers"):
        ChannelCore(Policy(consumers=2**20), incarnation=1)
