"""Message ids: a message that comes again under its id is taken once."""

from __future__ import annotations

import pytest

from stampede_rt_channel_host.core.queue import (
    message_ids,
)
from tests.support.channel_host.queue_cores import Core

TEN_MINUTES = 600 * 10**9


def test_message_ids_are_known_for_ten_minutes_and_forgotten_without_a_further_put() -> None:
    core = Core()
    core.put(1, message_id="one")
    assert core.put(1, message_id="one").is_duplicate
    assert core.queue.next_deadline() == core.now + TEN_MINUTES
    before = core.queue.footprint_bytes
    core.now += TEN_MINUTES
    core.queue.tick(core.now)
    assert core.queue.footprint_bytes == before - len("one") - message_ids.OVERHEAD_BYTES
    assert core.queue.next_deadline() is None
    assert not core.put(1, message_id="one").is_duplicate


def test_the_oldest_message_ids_are_forgotten_when_they_take_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(message_ids, "KNOWN_BYTES_MAX", 2 * (2 + message_ids.OVERHEAD_BYTES))
    core = Core()
    for message_id in ("a", "b", "c"):
        core.put(1, message_id=message_id)
    assert core.put(1, message_id="c").is_duplicate
    assert core.put(1, message_id="b").is_duplicate
    assert not core.put(1, message_id="a").is_duplicate


def test_a_caller_of_many_message_ids_makes_the_queue_forget_only_ids_of_that_caller(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, one caller with many ids made the queue forget the ids of others."""
    monkeypatch.setattr(message_ids, "KNOWN_BYTES_MAX", 100 * (4 + message_ids.OVERHEAD_BYTES))
    core = Core()
    good = [f"g{number}" for number in range(20)]
    for message_id in good:
        core.put(1, message_id=message_id, caller_name="good")
    for number in range(1000):
        core.put(1, message_id=f"x{number}", caller_name="greedy")
    assert core.queue.footprint_bytes < core.queue.counters(core.now).held * 500
    assert all(core.put(1, message_id=one, caller_name="good").is_duplicate for one in good)
    assert core.put(1, message_id="x999", caller_name="greedy").is_duplicate
    assert not core.put(1, message_id="x0", caller_name="greedy").is_duplicate


def test_forgotten_message_ids_use_no_memory() -> None:
    core, known = Core(), message_ids.MessageIds()
    for number in range(300):
        known.record(f"m{number}", number, core.now, caller_name=f"caller-{number % 7}")
    known.record("m0", 301, core.now + TEN_MINUTES + 1, caller_name="caller-0")
    while known.forget_one(core.now + 2 * TEN_MINUTES + 1):
        pass
    assert known.footprint_bytes == 0
    assert not known._messages_by_caller
    assert not known._bytes_by_caller


def test_only_one_of_two_waiting_runs_with_the_same_message_id_is_accepted() -> None:
    core = Core(max_items=1)
    core.put(1)
    first, second = core.put(1, message_id="one"), core.put(1, message_id="one")
    core.taker(1, credit=1)
    core.dispatched()
    core.ack(1, 1)
    assert core.queue.take_finished() == [first, second]
    assert (first.is_duplicate, second.is_duplicate) == (False, True)
    assert core.counted("accepted", "held", "duplicates") == (2, 1, 1)


def test_a_retry_of_a_put_with_a_message_id_is_answered_as_the_put_was() -> None:
    core = Core()
    core.put(1, message_id="one", producer_id=5, first_number=1)
    assert not core.put(1, message_id="one", producer_id=5, first_number=1).is_duplicate
    assert core.put(1, message_id="one", producer_id=5, first_number=2).is_duplicate
