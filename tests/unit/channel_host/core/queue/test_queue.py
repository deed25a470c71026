"""The rules of a queue, sentence by sentence."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument, Overloaded, QueueNotFound, Unavailable
from stampede_rt_channel_host.core.queue import (
    BATCH_BYTES_MAX,
    BLOCK,
    DROP_OLDEST,
    REJECT,
    TERMINATED,
    FailedDelivery,
    QueueCore,
    QueueLimits,
    dispatcher,
    due_work,
    enqueue_line,
)
from stampede_rt_channel_host.core.queue.due_work import DUE_PER_CALL_MAX
from tests.support.channel_host.queue_cores import Core

TEN_MINUTES = 600 * 10**9


def test_a_stale_acknowledgement_fails_because_the_lease_has_expired() -> None:
    core = Core(lease_nanos=10)
    core.put(1)
    core.taker(1, credit=1)
    core.now += 10
    assert core.ack(1, 1) == ["LEASE_EXPIRED"]
    assert core.counted("held", "leased", "leases_expired") == (1, 0, 1)


def test_a_lease_lasts_until_the_nanosecond_before_its_end() -> None:
    core = Core(lease_nanos=10)
    core.put(1)
    core.taker(1, credit=1)
    core.now += 9
    assert core.ack(1, 1) == [""]


def test_a_repeated_acknowledgement_of_the_same_taker_succeeds_for_ten_minutes() -> None:
    core = Core()
    core.put(1)
    core.taker(1, credit=1)
    assert core.ack(1, 1, 1) == ["", ""]
    core.now += TEN_MINUTES - 1
    assert core.ack(1, 1) == [""]
    core.now += 1
    assert core.ack(1, 1) == ["LEASE_EXPIRED"]


def test_a_taker_cannot_settle_the_delivery_of_another_taker() -> None:
    core = Core()
    core.put(1)
    core.taker(1, credit=1)
    assert core.ack(2, 1) == core.nack(2, 1) == core.extend(2, 1, 5) == ["LEASE_EXPIRED"]
    assert core.ack(1, 1) == [""]
    assert core.ack(2, 1) == core.nack(1, 1) == ["LEASE_EXPIRED"]


def test_an_extended_lease_is_counted_from_now_and_may_get_shorter() -> None:
    core = Core(lease_nanos=100)
    core.put(1)
    core.taker(1, credit=1)
    core.extend(1, 1, 5)
    assert core.queue.next_deadline() == core.now + 5
    core.extend(1, 1, 1000)
    assert core.queue.next_deadline() == core.now + 1000


def test_a_given_back_message_does_not_hold_up_other_messages_while_it_is_delayed() -> None:
    core = Core()
    core.put(1, 1)
    core.taker(1, credit=1)
    assert core.dispatched() == {1: [1]}
    core.nack(1, 1, delay_nanos=50)
    core.taker(2, credit=5)
    assert core.dispatched() == {2: [2]}
    core.now += 50
    core.queue.tick(core.now)
    assert core.dispatched() == {2: [1]}


def test_a_message_with_copies_is_delivered_to_that_many_different_takers() -> None:
    core = Core(copies=2)
    core.put(1, 1)
    for taker_id in (1, 1, 2, 3):
        core.taker(taker_id, credit=10)
    assert core.dispatched() == {1: [1, 2], 2: [1, 2]}
    core.ack(1, 1, 2)
    assert core.counted("held", "consumed") == (2, 0)
    core.ack(2, 3)
    assert core.counted("held", "consumed") == (1, 1)


def test_a_returned_copy_is_delivered_to_a_taker_that_has_not_had_the_message() -> None:
    core = Core(copies=2)
    core.put(1, 1)
    core.taker(1, credit=10)
    leaving = core.taker(2, credit=10)
    core.taker(3, credit=10)
    assert core.dispatched() == {1: [1, 2], 2: [1, 2]}
    core.queue.leave(leaving, core.now)
    core.put(1)
    assert core.dispatched() == {1: [3], 3: [3]}
    core.nack(2, 3)
    assert core.dispatched() == {3: [1]}


def test_waiting_takers_are_served_in_turn() -> None:
    core = Core()
    takers = [core.taker(number, credit=10) for number in (1, 2, 3)]
    core.put(*[1] * 6)
    assert core.dispatched() == {1: [1, 2], 2: [3, 4], 3: [5, 6]}
    core.put(1)
    core.put(1)
    assert core.dispatched() == {1: [7], 2: [8]}
    core.put(1)
    assert core.dispatched() == {3: [9]}
    assert core.queue.waiting_takers == len(takers)


def test_credit_bounds_the_messages_of_a_taker_and_drain_voids_the_credit() -> None:
    core = Core()
    taker = core.taker(1, credit=2)
    core.put(*[1] * 5)
    assert core.dispatched() == {1: [1, 2]}
    core.queue.grant(taker, 1, core.now)
    assert core.dispatched() == {1: [3]}
    core.queue.grant(taker, 0, core.now)
    core.queue.drain(taker)
    core.put(1)
    assert core.dispatched() == {}


def test_a_dispatched_message_that_was_not_sent_returns_without_a_counted_delivery() -> None:
    core = Core(max_deliveries=1)
    core.put(1, 1)
    taker = core.taker(1, credit=2)
    core.queue.take_batches()
    core.queue.leave(taker, core.now)
    assert core.counted("leased", "delivered", "expelled", "held") == (0, 0, 0, 2)
    core.taker(2, credit=2)
    assert core.dispatched() == {2: [1, 2]}


def test_messages_sent_to_a_taker_are_still_leased_when_the_taker_leaves() -> None:
    core = Core()
    core.put(1)
    taker = core.taker(1, credit=1)
    core.dispatched()
    core.queue.leave(taker, core.now)
    assert core.counted("leased") == (1,)
    assert core.ack(1, 1) == [""]


def test_a_taker_that_leaves_when_a_lease_ends_gets_no_message() -> None:
    core = Core(lease_nanos=100)
    core.put(1)
    silent, waiting, leaving = core.taker(1, credit=2), core.taker(2), core.taker(3)
    core.dispatched()
    core.queue.grant(leaving, 1, core.now)
    core.now += 200  # the lease of the silent taker ends, and the leaving taker is next in line
    core.queue.leave(leaving, core.now)
    assert core.dispatched() == {}
    core.queue.grant(waiting, 1, core.now)
    assert core.dispatched() == {2: [1]}
    assert core.queue.take_silent() == [silent]
    core.queue.grant(silent, 1, core.now)
    core.put(1)
    core.dispatched()
    core.now += 200
    core.queue.leave(silent, core.now)
    assert silent not in core.queue.take_silent()


def test_a_batch_keeps_the_limit_of_a_response_and_a_large_message_is_sent_separately() -> None:
    core = Core()
    for length in (BATCH_BYTES_MAX // 2 - 100, BATCH_BYTES_MAX // 2 - 100, 10**3, 2 * BATCH_BYTES_MAX, 1):
        core.put(length)
    taker = core.taker(1, credit=10)
    sizes = []
    while batches := core.queue.take_batches():
        sizes += [batch.items for _, batch in batches]
        core.queue.note_sent(taker, core.now)
    assert sizes == [2, 1, 1, 1]


def test_runs_wait_at_a_full_queue_in_the_order_of_their_arrival() -> None:
    core = Core(max_items=2)
    core.put(1, 1)
    first, second = core.put(1, 1), core.put(1)
    core.taker(1, credit=10)
    core.dispatched()
    core.ack(1, 1)
    assert (first.progress.first_seq, first.is_done, second.progress.first_seq) == (3, False, None)
    core.ack(1, 2)
    assert core.queue.take_finished() == [first]
    assert (first.progress.first_seq, core.queue.waiting_enqueues) == (3, 1)


def test_a_put_whose_wait_is_over_refuses_the_rest_of_its_run() -> None:
    core = Core(max_items=1)
    run = core.put(1, 1, 1, wait_nanos=20)
    core.now += 20
    core.queue.tick(core.now)
    assert core.queue.take_finished() == [run]
    assert run.outcome is not None
    assert (run.outcome.first_seq, [one.position for one in run.outcome.refusals]) == (1, [1, 2])
    assert core.counted("accepted", "rejected_full") == (1, 2)


def test_a_retry_of_a_partly_accepted_run_continues_at_its_position() -> None:
    """In an earlier version, the queue kept the refusal of the rest, and refused the retry, too, though it had room by
    then.
    """
    core = Core(max_items=1)
    run = core.put(1, 1, 1, producer_id=5, first_number=1)
    core.queue.withdraw(run, core.now)
    assert core.counted("accepted", "rejected_full") == (1, 0)
    core.now += 5
    repeated = core.put(1, 1, 1, producer_id=5, first_number=1)
    core.taker(1, credit=3)
    core.dispatched()
    core.ack(1, 1)
    core.dispatched()
    core.ack(1, 2)
    assert core.queue.take_finished() == [repeated]
    assert repeated.outcome is not None
    assert [tuple(part) for part in repeated.outcome.parts] == [(0, 1, 3, 1000)], "consecutive seqs have one time"
    assert not repeated.outcome.refusals
    assert core.counted("accepted") == (3,)


def test_the_ack_of_a_continued_run_does_not_name_the_seqs_of_a_run_in_between() -> None:
    core = Core(max_items=1)
    run = core.put(1, 1, producer_id=5, first_number=1)
    core.queue.withdraw(run, core.now)
    other = core.put(1)
    repeated = core.put(1, 1, producer_id=5, first_number=1)
    core.taker(1, credit=3)
    for delivery_id in (1, 2):
        core.dispatched()
        core.ack(1, delivery_id)
    assert core.queue.take_finished() == [other, repeated]
    assert repeated.outcome is not None
    assert [tuple(part) for part in repeated.outcome.parts] == [(0, 1, 1, 1000), (1, 3, 1, 1000)]


def test_a_waiting_run_of_a_moving_queue_is_accepted_when_it_is_sent_again() -> None:
    core = Core(max_items=1)
    run = core.put(1, 1, producer_id=5, first_number=1)
    assert not core.queue.refuse_waiting(Unavailable("the lease is lost", reason="NOT_HERE"), core.now)
    assert core.queue.take_finished() == [run]
    assert run.error is not None
    assert run.error.retryable
    state = core.queue.export(core.now)
    core.queue = QueueCore.restore(core.queue.limits, state, core.now, incarnation=1)
    core.queue.configure(QueueLimits(max_items=2), core.now)
    repeated = core.put(1, 1, producer_id=5, first_number=1)
    assert repeated.outcome is not None
    assert [tuple(part) for part in repeated.outcome.parts] == [(0, 1, 2, 1000)]


def test_the_rest_of_a_partly_accepted_run_is_refused_when_its_queue_is_dropped() -> None:
    core = Core(max_items=1)
    run = core.put(1, 1, producer_id=5, first_number=1)
    assert not core.queue.refuse_waiting(QueueNotFound("deleted"), core.now)
    assert run.outcome is not None
    assert [(one.position, one.error.reason) for one in run.outcome.refusals] == [(1, "QUEUE_NOT_FOUND")]


def test_a_retried_waiting_run_is_accepted_once() -> None:
    core = Core(max_items=1)
    core.put(1)
    first = core.put(1, producer_id=5, first_number=1)
    retried = core.put(1, producer_id=5, first_number=1)
    core.taker(1, credit=1)
    core.dispatched()
    core.ack(1, 1)
    assert core.queue.take_finished() == [first, retried]
    assert first.outcome == retried.outcome
    assert core.counted("accepted", "held") == (2, 1)


def test_the_refusal_of_a_full_queue_states_its_content_and_gives_advice() -> None:
    core = Core(max_bytes=200, on_full=REJECT)
    run = core.put(100, 100)
    assert run.outcome is not None
    (rejection,) = run.outcome.refusals
    assert rejection.error.reason == "QUEUE_FULL"
    assert "'q'" in rejection.error.message
    assert "200 bytes" in rejection.error.message


def test_the_oldest_messages_without_a_lease_make_room() -> None:
    core = Core(max_items=3, on_full=DROP_OLDEST)
    core.put(1, 1, 1)
    core.taker(1, credit=1)
    core.dispatched()
    core.put(1, 1)
    assert core.counted("dropped", "held") == (2, 3)
    core.taker(2, credit=5)
    assert core.dispatched() == {2: [4, 5]}
    run = core.put(1)
    assert run.outcome is not None
    assert [one.error.reason for one in run.outcome.refusals] == ["QUEUE_FULL"]


def test_a_message_that_was_delivered_too_often_is_expelled_with_its_other_leases() -> None:
    core = Core(copies=2, max_deliveries=1)
    core.put(1)
    core.taker(1, credit=1)
    core.taker(2, credit=1)
    core.dispatched()
    core.nack(1, 1)
    assert core.ack(2, 2) == ["LEASE_EXPIRED"]
    assert core.counted("expelled", "held", "leased") == (1, 0, 0)


def test_a_message_for_the_dead_letter_queue_is_held_until_it_has_departed() -> None:
    core = Core(max_deliveries=1, dead_letters=True, max_items=1)
    core.put(1)
    core.taker(1, credit=5)
    core.dispatched()
    core.nack(1, 1)
    assert [one.seq for one in core.queue.dead_letters(10)] == [1]
    assert core.counted("held", "dead_lettered") == (1, 0)
    waiting = core.put(1)
    core.queue.dead_letter_moved(1, core.now)
    core.queue.dead_letter_moved(1, core.now)
    assert core.counted("dead_lettered", "held", "accepted") == (1, 1, 2)
    assert core.queue.take_finished() == [waiting]
    assert core.dispatched() == {1: [2]}


def test_a_lowered_number_of_deliveries_applies_immediately_to_messages_that_were_delivered_more_often() -> None:
    core = Core(max_deliveries=9, dead_letters=True)
    core.put(1, 1, 1)
    core.taker(1, credit=5)
    core.dispatched()
    for delivery_id in (1, 2, 4, 5, 3):  # the first and the second message twice, the third once
        core.nack(1, delivery_id)
        core.dispatched()
    core.queue.configure(QueueLimits(max_deliveries=2, dead_letters=True), core.now)
    assert [one.seq for one in core.queue.dead_letters(10)] == [1, 2]
    core.taker(2, credit=1)
    assert core.dispatched() == {2: [3]}
    core.nack(2, 6)
    assert [one.seq for one in core.queue.dead_letters(10)] == [1, 2, 3]


def test_after_new_limits_a_queue_checks_a_few_messages_a_step_and_delivers_none_before_all_are_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(due_work, "CHECKED_PER_CALL_MAX", 4)
    core = Core()
    core.put(*[1] * 10)
    giver = core.taker(1, credit=10)
    core.dispatched()
    for delivery_id in range(1, 11):
        core.nack(1, delivery_id)
    core.queue.drain(giver)
    core.queue.configure(QueueLimits(max_deliveries=1), core.now)
    core.taker(2, credit=10)
    assert core.dispatched() == {}
    assert core.queue.next_deadline() == core.now
    while core.queue.next_deadline() is not None:
        core.queue.tick(core.now)
    assert core.counted("expelled", "held") == (10, 0)


def test_a_terminated_message_loses_its_other_leases_and_its_last_delivery_is_reported() -> None:
    core = Core(copies=2, dead_letters=True)
    core.put(1)
    core.taker(1, credit=1)
    core.taker(2, credit=1)
    core.dispatched()
    assert core.term(2, 2, "broken") == [""]
    assert core.ack(1, 1) == ["LEASE_EXPIRED"]
    (dead_letter,) = core.queue.dead_letters(10)
    assert dead_letter.last == FailedDelivery(1, 2, "", TERMINATED, "broken")
    assert core.counted("terminated", "leased", "held") == (1, 0, 1)


def test_the_line_of_runs_that_wait_is_bounded_by_number_and_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enqueue_line, "WAITING_RUNS_MAX", 2)
    core = Core(max_items=1)
    core.put(1)
    core.put(1)
    core.put(1)
    with pytest.raises(Overloaded, match="2 runs with 130 bytes wait"):
        core.put(1)
    monkeypatch.setattr(enqueue_line, "WAITING_RUNS_MAX", 10)
    monkeypatch.setattr(enqueue_line, "WAITING_BYTES_MAX", 200)
    with pytest.raises(Overloaded):
        core.put(100)


def test_the_waiting_runs_of_one_caller_leave_room_for_the_runs_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, a few large runs of one caller made the queue refuse the runs of all others, which could
    have waited.
    """
    monkeypatch.setattr(enqueue_line, "WAITING_BYTES_MAX", 4000)
    monkeypatch.setattr(enqueue_line, "WAITING_BYTES_OF_ONE_MAX", 3000)
    core = Core(max_items=1)
    core.put(1)
    first = core.put(2900, caller_name="greedy")
    with pytest.raises(Overloaded, match=r"greedy with 29.. bytes wait for room .* one caller may have 3000"):
        core.put(900, caller_name="greedy")
    waiting = core.put(900, caller_name="good")
    assert not waiting.is_done
    core.queue.withdraw(first, core.now)
    core.queue.withdraw(waiting, core.now)
    assert not core.put(3500, caller_name="greedy").is_done, "one run of each caller may wait, however large"


def test_one_call_handles_a_bounded_number_of_ended_leases_and_the_next_call_is_due_immediately() -> None:
    core = Core(lease_nanos=10)
    for _ in range(8):
        core.put(*[1] * 256)
    core.taker(1, credit=2048)
    core.dispatched()
    core.now += 10
    core.queue.tick(core.now)
    assert core.queue.next_deadline() is not None
    assert core.queue.next_deadline() <= core.now  # type: ignore[operator]
    assert core.counted("leases_expired") == (2 * DUE_PER_CALL_MAX,)


def test_overlapping_numbers_of_a_producer_are_refused() -> None:
    core = Core()
    core.put(1, 1, producer_id=5, first_number=1)
    with pytest.raises(InvalidArgument, match="overlap"):
        core.put(1, 1, producer_id=5, first_number=2)


@pytest.mark.parametrize("field", ["max_items", "max_bytes", "copies", "lease_nanos", "max_deliveries"])
def test_the_error_for_a_limit_below_one_names_the_limit(field: str) -> None:
    with pytest.raises(InvalidArgument, match=field):
        QueueLimits(**{field: 0})


def test_an_unknown_rule_for_a_full_queue_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="on_full"):
        QueueLimits(on_full=BLOCK.upper())


def test_a_taker_finds_every_returned_copy_even_with_few_looks_per_call(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dispatcher, "RETURNS_PER_LOOK_MAX", 2)
    core = Core(copies=2)
    core.put(*[1] * 50)
    core.taker(1, credit=50)
    leaving = core.taker(2, credit=50)
    late = core.taker(3, credit=0)
    core.dispatched()
    core.queue.leave(leaving, core.now)
    core.queue.grant(late, 1, core.now)
    for delivery_id in range(100, 50, -1):
        core.nack(2, delivery_id)
    core.queue.grant(late, 100, core.now)
    assert sorted(core.dispatched()[3]) == list(range(1, 51))


def test_a_moved_queue_continues_with_its_state() -> None:
    core = Core(copies=2, lease_nanos=100)
    core.put(1, 2, 3, producer_id=5, first_number=1, caller_name="ann")
    core.taker(1, credit=2)
    core.dispatched()
    core.ack(1, 1)
    core.nack(1, 2, delay_nanos=40)
    core.taker(2, credit=1)
    core.dispatched()
    state = core.queue.export(core.now + 10)
    assert [(one.seq, one.deliveries, one.acknowledged, one.delay_nanos) for one in state.items] == [
        (1, [1], (1,), 0),
        (2, [1], (), 30),
    ]
    core.queue = QueueCore.restore(core.queue.limits, state, 10**6, incarnation=1)
    core.now = 10**6
    assert [one.caller_name for one in core.queue.export(core.now).producers] == ["ann"], (
        "the state has the callers, too"
    )
    assert core.counted("accepted", "held", "leased", "delivered", "given_back") == (3, 3, 1, 3, 1)
    assert core.ack(1, 1) == core.ack(2, 3) == [""]
    repeated = core.put(1, 2, 3, producer_id=5, first_number=1)
    assert repeated.outcome is not None
    assert repeated.outcome.first_seq == 1, "the queue recognised the run"
    core.taker(3, credit=5)
    assert core.dispatched() == {3: [3]}
    core.now += 30
    core.queue.tick(core.now)
    assert core.dispatched() == {3: [2]}
    last = core.put(1)
    assert last.outcome is not None
    assert last.outcome.first_seq == 4
