"""Time limits of the blocking client: each one works, whatever happens at the others."""

from __future__ import annotations

import logging
import threading

import pytest

from stampede_rt.transports.watchdog import Watchdog

LIMIT_S = 10.0


def test_the_function_of_an_exceeded_time_limit_is_called_and_the_limit_reports_this() -> None:
    watchdog, called = Watchdog(), threading.Event()
    with watchdog.limit(0.01, called.set) as overdue:
        assert called.wait(LIMIT_S)
    assert overdue
    watchdog.close()


def test_the_function_of_a_limit_that_is_kept_is_not_called() -> None:
    watchdog, called, later = Watchdog(), threading.Event(), threading.Event()
    with watchdog.limit(0.05, called.set) as overdue:
        pass
    with watchdog.limit(0.1, later.set):
        assert later.wait(LIMIT_S)
    assert not overdue
    assert not called.is_set()
    watchdog.close()


def test_a_limit_is_set_while_another_is_being_called_back() -> None:
    watchdog, reached, release, called = Watchdog(), threading.Event(), threading.Event(), threading.Event()

    def held_up() -> None:
        reached.set()
        release.wait(LIMIT_S)

    with watchdog.limit(0.01, held_up):
        assert reached.wait(LIMIT_S)
        other = watchdog.limit(0.01, called.set)
        others = threading.Thread(target=other.__enter__)
        others.start()
        others.join(LIMIT_S)
        assert not others.is_alive()
        release.set()
        assert called.wait(LIMIT_S)
        other.__exit__(None, None, None)
    watchdog.close()


def test_a_function_that_never_returns_does_not_keep_the_others_from_being_called() -> None:
    watchdog, reached, release, called = Watchdog(), threading.Event(), threading.Event(), threading.Event()

    def stuck() -> None:
        reached.set()
        release.wait()

    with watchdog.limit(0.01, stuck), watchdog.limit(0.02, called.set):
        assert reached.wait(LIMIT_S)
        assert called.wait(LIMIT_S)
    release.set()
    watchdog.close()


def test_a_limit_whose_call_back_fails_does_not_end_the_others(caplog: pytest.LogCaptureFixture) -> None:
    watchdog, called = Watchdog(), threading.Event()

    def fail() -> None:
        raise ValueError("closed")

    with caplog.at_level(logging.ERROR), watchdog.limit(0.01, fail), watchdog.limit(0.02, called.set):
        assert called.wait(LIMIT_S)
    assert "overdue" in caplog.text
    watchdog.close()
