"""The answers of a copy to readers, by its age and its position."""

from __future__ import annotations

import asyncio

import pytest

from stampede_rt.errors import StaleBinding
from stampede_rt_channel_host.channels.copy_state import SERVED_STALENESS_NANOS_MAX, CopyState, Freshness

S = 10**9


class Clock:
    nanos = 100 * S

    def __call__(self) -> int:
        return self.nanos


def state_at(clock: Clock) -> CopyState:
    state = CopyState(steady_nanos=clock)
    state.as_of_nanos, state.caught_up = clock.nanos, True
    return state


def test_a_copy_that_has_not_caught_up_serves_no_caller() -> None:
    state = CopyState()
    with pytest.raises(StaleBinding, match="has not caught up"):
        state.check("cam", 10, Freshness())


def test_a_copy_serves_reads_that_accept_its_staleness() -> None:
    clock = Clock()
    state = state_at(clock)
    clock.nanos += S
    state.check("cam", 10, Freshness(max_staleness_nanos=S))
    with pytest.raises(StaleBinding, match=r"may be 1 s old, and the read accepts 999 ms"):
        state.check("cam", 10, Freshness(max_staleness_nanos=S - 10**6))


def test_a_copy_serves_reads_of_items_that_it_has() -> None:
    state = state_at(Clock())
    state.check("cam", 10, Freshness(least_seq=9))
    with pytest.raises(StaleBinding, match="up to seq 9, and the read wants seq 10"):
        state.check("cam", 10, Freshness(least_seq=10))


def test_some_time_after_the_loss_of_its_source_a_copy_serves_no_caller() -> None:
    clock = Clock()
    state = state_at(clock)
    clock.nanos += SERVED_STALENESS_NANOS_MAX
    state.check("cam", 10, Freshness())
    clock.nanos += 1
    with pytest.raises(StaleBinding, match="has lost its source"):
        state.check("cam", 10, Freshness())


async def test_a_reader_that_is_ahead_waits_until_the_copy_has_caught_up_with_it() -> None:
    state, next_seq = state_at(Clock()), 5
    waiting = asyncio.ensure_future(state.reach("cam", lambda: next_seq, 7))
    await asyncio.sleep(0)
    assert not waiting.done()
    next_seq = 7
    state.note_progress()
    await waiting


async def test_a_reader_that_is_ahead_of_a_copy_for_too_long_is_sent_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stampede_rt_channel_host.channels.copy_state.REACH_SECONDS_MAX", 0.01)
    with pytest.raises(StaleBinding, match="wants seq 6"):
        await state_at(Clock()).reach("cam", lambda: 5, 7)
