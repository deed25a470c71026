"""Repeated tries of an operation: after temporary errors, until its time is over; and the error at the end."""

from __future__ import annotations

from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async import attempts
from stampede_rt._async.attempts import TRY_S_MIN, attempt
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.directory_call import CUT_SHORT
from stampede_rt.errors import error_for
from stampede_rt.pacing.retry import OPEN_STREAMS_S

BINDING = Binding(subject_id=b"c" * 16, target="host:1", epoch=3, incarnation=7)


class Clock:
    """Time that passes only in sleeps."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    async def sleep(self, delay_s: float) -> None:
        self.now_s += delay_s


class FixedLocator:
    """A locator that always finds the same binding. `forgotten` counts how often the binding turned out to be stale."""

    closed = False
    names_a_lost_channel = False

    def __init__(self) -> None:
        self.forgotten = 0

    async def find(self, deadline_s: float) -> Binding:
        return BINDING

    def is_stale(self, error: st.StampedeError) -> bool:
        return self.names_a_lost_channel and isinstance(error, st.ChannelNotFound)

    def forget(self, error: st.StampedeError | None = None) -> None:
        self.forgotten += 1

    def check(self) -> None:
        return None

    def explain(self, error: st.StampedeError) -> None:
        return None


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(attempts, "time", clock)
    monkeypatch.setattr(attempts, "sleep", clock.sleep)
    return clock


class Operation:
    """Raises one error after the other, and then succeeds. With `for_ever` it raises the last error again and again."""

    def __init__(self, *errors: st.StampedeError, for_ever: bool = False) -> None:
        self.errors = list(errors)
        self.for_ever = for_ever

    async def __call__(self, binding: Binding, timeout_s: float) -> str:
        if not self.errors:
            return "done"
        raise self.errors[0] if self.for_ever and len(self.errors) == 1 else self.errors.pop(0)


async def test_an_operation_whose_host_does_not_answer_in_time_is_tried_again(clock: Clock) -> None:
    locator = FixedLocator()
    operation = Operation(st.DeadlineExceeded("slow"), st.Unavailable("gone"), st.DeadlineExceeded("slow"))
    assert await attempt(locator, operation, 10) == "done"
    assert locator.forgotten == 3


async def test_a_last_try_that_was_cut_short_does_not_hide_the_failure_of_the_earlier_tries(clock: Clock) -> None:
    operation = Operation(st.Unavailable("gone"), st.DeadlineExceeded("too little time"), for_ever=True)
    with pytest.raises(st.Unavailable, match="gone"):
        await attempt(FixedLocator(), operation, 10)


@pytest.mark.parametrize(("began_s", "expected"), [(9.5, "gone"), (5.0, "no majority")])
async def test_a_majority_that_is_not_found_at_the_very_end_does_not_hide_the_failure_of_the_earlier_tries(
    began_s: float, expected: str, clock: Clock
) -> None:
    async def fail(binding: Binding, timeout_s: float) -> str:
        if clock.now_s < 100 + began_s:
            raise st.Unavailable("gone")
        raise st.Unavailable("no majority", reason="NO_QUORUM")

    with pytest.raises(st.Unavailable, match=expected):
        await attempt(FixedLocator(), fail, 10)


async def test_a_call_to_the_directory_without_enough_time_does_not_hide_the_failure_of_the_earlier_tries(
    clock: Clock,
) -> None:
    async def fail(binding: Binding, timeout_s: float) -> str:
        if clock.now_s < 105:
            raise st.Unavailable("gone")
        clock.now_s = 110  # a first call has taken all the time, and a second one found no majority
        raise st.Unavailable("no majority", reason="NO_QUORUM", metadata={CUT_SHORT: "true"})

    with pytest.raises(st.Unavailable, match="gone"):
        await attempt(FixedLocator(), fail, 10)


async def test_a_host_that_never_answers_ends_the_call_with_deadline_exceeded(clock: Clock) -> None:
    with pytest.raises(st.DeadlineExceeded, match="slow"):
        await attempt(FixedLocator(), Operation(st.DeadlineExceeded("slow"), for_ever=True), 10)
    assert clock.now_s == pytest.approx(110)


@pytest.mark.parametrize("taken_s", [0.7, 3.0, 9.99])
async def test_no_try_may_take_longer_than_the_call(taken_s: float, clock: Clock) -> None:
    """In an earlier version, the last try began within the time of the call, and could then take the full time of a
    call.
    """
    allowed: list[tuple[float, float]] = []

    async def fail_slowly(binding: Binding, timeout_s: float) -> str:
        allowed.append((clock.now_s, timeout_s))
        clock.now_s += min(taken_s, timeout_s)
        raise st.DeadlineExceeded("slow") if timeout_s <= taken_s else st.Unavailable("gone")

    with pytest.raises(st.Unavailable):
        await attempt(FixedLocator(), fail_slowly, 10)
    assert allowed[0] == (100, 10)
    assert all(began_s + timeout_s == pytest.approx(110, abs=TRY_S_MIN) for began_s, timeout_s in allowed)
    assert clock.now_s <= 110 + TRY_S_MIN


@pytest.mark.parametrize("error", [st.ChannelNotFound("none"), st.InvalidArgument("wrong")])
async def test_a_permanent_error_is_raised_immediately(clock: Clock, error: Any) -> None:
    locator = FixedLocator()
    with pytest.raises(type(error)):
        await attempt(locator, Operation(error), 10)
    assert (locator.forgotten, clock.now_s) == (0, 100)


async def tries(quota: str, clock: Clock) -> tuple[int, float]:
    """The number of tries of an operation that meets this quota, and their time together."""
    locator, began_s = FixedLocator(), clock.now_s
    operation = Operation(st.Overloaded("cam has 3; its quota is 3", metadata={"quota": quota}), for_ever=True)
    with pytest.raises(st.Overloaded):
        await attempt(locator, operation, 10)
    return locator.forgotten + (locator.forgotten == 0), clock.now_s - began_s


@pytest.mark.parametrize("quota", ["channels", "queues"])
async def test_a_call_beyond_a_quota_that_only_a_deletion_frees_is_not_repeated(quota: str, clock: Clock) -> None:
    assert await tries(quota, clock) == (1, 0)


@pytest.mark.parametrize("quota", ["streams", "subscriptions"])
async def test_a_call_beyond_the_quota_of_open_streams_is_repeated_only_for_a_moment(quota: str, clock: Clock) -> None:
    count, time_s = await tries(quota, clock)
    assert count < 12
    assert time_s <= OPEN_STREAMS_S + 0.02


async def test_a_call_beyond_a_quota_that_time_frees_is_repeated_until_its_deadline(clock: Clock) -> None:
    assert (await tries("changes-per-second", clock))[1] == pytest.approx(10)


async def test_an_operation_follows_the_first_move_of_its_channel_immediately_and_later_ones_after_pauses(
    clock: Clock,
) -> None:
    locator, moved = FixedLocator(), error_for("MOVED", "the channel has moved", {})
    assert await attempt(locator, Operation(moved), 10.0) == "done"
    assert (clock.now_s, locator.forgotten) == (100.0, 1)
    assert await attempt(locator, Operation(moved, moved), 10.0) == "done"
    assert clock.now_s > 100.0


async def test_a_deleted_channel_is_looked_up_once_more_before_the_error_is_raised(clock: Clock) -> None:
    locator, calls = FixedLocator(), 0
    locator.names_a_lost_channel = True

    async def missing(binding: Binding, timeout_s: float) -> None:
        nonlocal calls
        calls += 1
        raise st.ChannelNotFound("gone")

    with pytest.raises(st.ChannelNotFound):
        await attempt(locator, missing, 10.0)
    assert (calls, locator.forgotten, clock.now_s) == (2, 1, 100.0)
