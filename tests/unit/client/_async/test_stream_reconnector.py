"""A broken stream is opened again at growing intervals, for as long as the user allows."""

from __future__ import annotations

import logging
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async import stream_reconnector
from stampede_rt._async.stream_reconnector import StreamReconnector, parse_reconnect


class Session:
    closing = closed = False


class Clock:
    """A clock that moves only during sleeps."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept: list[float] = []

    def monotonic_s(self) -> float:
        return self.now_s

    async def sleep(self, delay_s: float) -> None:
        self.slept.append(delay_s)
        self.now_s += delay_s


class FailingOpener:
    """Raises the given errors one by one, and then succeeds. Keeps the time limit of each try."""

    def __init__(self, *errors: Exception) -> None:
        self.errors = list(errors)
        self.allowed_s: list[float] = []

    async def __call__(self, timeout_s: float) -> None:
        self.allowed_s.append(timeout_s)
        if self.errors:
            raise self.errors.pop(0)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(stream_reconnector, "monotonic_s", clock.monotonic_s)
    monkeypatch.setattr(stream_reconnector, "sleep", clock.sleep)
    return clock


def made(reconnect: Any = None, **settings: Any) -> StreamReconnector:
    return StreamReconnector(Session(), "the subscription to channel 'cam'", reconnect, **settings)  # type: ignore[arg-type]


async def test_the_error_of_a_stream_that_never_opened_is_raised_immediately(clock: Clock) -> None:
    one = made()
    with pytest.raises(st.Unavailable):
        await one.open(FailingOpener(st.Unavailable("no")))
    assert (clock.slept, one.connected) == ([], False)


async def test_an_outage_of_any_length_ends_with_the_stream_open_and_counted_once(clock: Clock) -> None:
    one = made()
    await one.open(FailingOpener())
    assert one.connected
    one.broke()
    assert not one.connected
    opening = FailingOpener(*[st.Unavailable("down") for _ in range(5000)])
    await one.open(opening)
    assert len(opening.allowed_s) == 5001
    assert clock.now_s > 3600
    assert max(clock.slept) <= 1.0, "the client tries again at least each second"
    assert (one.reconnects, one.connected) == (1, True)


async def test_reconnecting_ends_at_its_time_limit_and_the_next_call_has_the_whole_limit_again(clock: Clock) -> None:
    one = made("2s")
    await one.open(FailingOpener())
    for _ in range(2):
        began_s = clock.now_s
        one.broke()
        with pytest.raises(st.Unavailable, match="down"):
            await one.open(FailingOpener(*[st.Unavailable("down") for _ in range(5000)]))
        assert clock.now_s - began_s == pytest.approx(2.0)
    await one.open(FailingOpener())


async def test_reconnecting_ends_when_its_connection_closes(clock: Clock) -> None:
    one = made(held=True)
    one._session.closing = True
    opening = FailingOpener(st.Unavailable("this connection is closed"))
    with pytest.raises(st.Unavailable, match="this connection is closed"):
        await one.open(opening)
    assert (len(opening.allowed_s), clock.slept) == (1, [])


async def test_reconnecting_with_a_time_limit_of_zero_tries_once(clock: Clock) -> None:
    one = made("0s", held=True)
    opening = FailingOpener(st.Unavailable("down"), st.Unavailable("down"))
    with pytest.raises(st.Unavailable):
        await one.open(opening)
    assert (len(opening.allowed_s), clock.slept) == (1, [])


@pytest.mark.parametrize("error", [st.IncarnationLost("gone"), st.ChannelNotFound("gone"), st.PermissionDenied("no")])
async def test_an_error_that_a_retry_cannot_mend_is_raised_immediately(clock: Clock, error: st.StampedeError) -> None:
    with pytest.raises(type(error)):
        await made(held=True).open(FailingOpener(error))
    assert clock.slept == []


async def test_a_call_that_took_too_long_is_an_outage_like_others(clock: Clock) -> None:
    one = made(held=True)
    await one.open(FailingOpener(st.DeadlineExceeded("slow"), st.Overloaded("full")))
    assert one.reconnects == 1


async def test_a_stop_during_an_attempt_ends_the_reconnecting_without_an_error(clock: Clock) -> None:
    one = made(held=True)

    async def opening(timeout_s: float) -> None:
        one.stop()
        raise st.Unavailable("down")

    await one.open(opening)
    assert (one.reconnects, one.connected, clock.slept) == (0, False, [])


async def test_a_stream_that_opens_at_the_first_try_is_not_counted_as_reconnected(clock: Clock) -> None:
    one = made(held=True)
    await one.open(FailingOpener())
    assert one.reconnects == 0


async def test_a_long_outage_has_a_line_in_the_log_at_its_beginning_and_at_its_end(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    one = made(held=True)
    with caplog.at_level(logging.WARNING, "stampede_rt"):
        await one.open(FailingOpener(*[st.Unavailable("down") for _ in range(100)]))
    assert [record.getMessage().split(":")[0].rsplit(" after")[0] for record in caplog.records] == [
        "the subscription to channel 'cam' has been broken for 10 s; the client tries again",
        "the subscription to channel 'cam' is back",
    ]


def test_the_bound_is_a_duration_or_none() -> None:
    assert parse_reconnect(None) == float("inf")
    assert parse_reconnect("1.5s") == 1.5
    for wrong in ("-1s", 10, "soon"):
        with pytest.raises(st.InvalidArgument, match="reconnect"):
            parse_reconnect(wrong)  # type: ignore[arg-type]
