"""The instants of acceptance: each held item keeps its own, and the others take no memory."""

from __future__ import annotations

import random

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import Acceptances, AcceptedRows, ChannelCore, Offer
from stampede_rt_channel_host.core.channel.acceptances import CHUNK_BYTES, ROW_BYTES, ROWS_PER_CHUNK


def channel(max_items: int = 10) -> ChannelCore:
    return ChannelCore(Policy(max_items=max_items, max_future_nanos=2**60), incarnation=1)


def put(one: ChannelCore, time: int, now: int) -> None:
    offer = Offer(times=[time], durations=None, lengths=[1])
    one.put(offer, now, lambda seq, kept, stamped: b"%d" % seq)


@pytest.mark.parametrize("seed", range(5))
def test_each_held_item_has_the_instant_of_its_put(seed: int) -> None:
    draw, one, known, now = random.Random(seed), channel(max_items=40), Acceptances(), 1
    instants: dict[int, int] = {}
    for _ in range(20 * ROWS_PER_CHUNK):
        now += draw.choice([0, 1, 1, 5])
        put(one, now + draw.choice([0, 0, 0, 10**6, -3]), now)
        for seq in range(known.end_seq or 1, one.next_seq):
            instants[seq] = now
        known.note(one.next_seq, now, one.held)
    held = [seq for part in one.accepted_from(0) for seq in range(part.first_seq, part.end_seq)]
    assert len(held) == 40
    assert [known.at(seq) for seq in held] == [instants[seq] for seq in held]
    rows, other = known.between(held[0], one.next_seq), Acceptances()
    other.take(rows, now, one.held)
    assert [other.at(seq) for seq in held] == [instants[seq] for seq in held]
    assert known.footprint_bytes <= 6 * ROWS_PER_CHUNK * ROW_BYTES + 10 * CHUNK_BYTES


def test_an_item_of_the_far_future_keeps_its_instant_and_the_memory_stays_bounded() -> None:
    one, known = channel(max_items=2), Acceptances()
    put(one, 10**12, 5)
    known.note(2, 5, one.held)
    for now in range(6, 30 * ROWS_PER_CHUNK):
        put(one, now, now)
        known.note(one.next_seq, now, one.held)
    assert known.at(1) == 5
    assert known.footprint_bytes <= 4 * ROWS_PER_CHUNK * ROW_BYTES + 10 * CHUNK_BYTES


def test_an_item_without_a_known_instant_has_that_of_the_next_item_and_none_is_known_after_the_last_one() -> None:
    one, known = channel(), Acceptances()
    assert (known.at(1), known.between(1, 9)) == (None, AcceptedRows((), ()))
    known.note(4, 10, one.held)
    known.note(6, 20, one.held)
    assert [known.at(seq) for seq in range(1, 7)] == [10, 10, 10, 20, 20, None]
    assert known.between(2, 5) == AcceptedRows((4, 5), (10, 20))
    assert known.between(4, 9) == AcceptedRows((6,), (20,))


def test_instants_of_a_clock_that_is_ahead_end_at_the_present_and_none_goes_back() -> None:
    one, known = channel(), Acceptances()
    known.take(AcceptedRows((2, 3, 4), (10, 99, 120)), 50, one.held)
    known.note(5, 49, one.held)
    assert [known.at(seq) for seq in range(1, 5)] == [10, 50, 50, 50]
