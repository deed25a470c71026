"""Ctrl-C at bad places. Each program is a process of its own: a signal's handler belongs to a main thread."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap

import pytest

from tests.support.processes import started

PATIENCE_S = 20
FOREVER = 10**9
PRELUDE = """
    import os, signal, sys, threading, weakref
    from stampede_rt.cli import interrupts

    def ctrl_c():
        os.kill(os.getpid(), signal.SIGINT)

    def ctrl_c_and_wait():
        ctrl_c()
        while not interrupts.interruption.requested:
            pass
"""


def ended(program: str) -> tuple[int, str]:
    """The exit status and the output of a program."""
    source = textwrap.dedent(PRELUDE) + textwrap.dedent(program)
    with started([sys.executable, "-c", source], stderr=subprocess.STDOUT) as process:
        out, _ = process.communicate(timeout=PATIENCE_S)
    return process.returncode, out


def test_work_that_ends_gives_its_status() -> None:
    assert ended("sys.exit(interrupts.run_interruptibly(lambda: 3))") == (3, "")


def test_an_error_of_the_work_is_raised() -> None:
    assert ended("interrupts.run_interruptibly(lambda: sys.exit(2))") == (2, "")


def test_work_that_waits_for_a_lock_for_ever_ends_with_ctrl_c() -> None:
    program = """
    def work():
        ctrl_c_and_wait()
        threading.Lock().acquire() and threading.Event().wait()

    interrupts.CLOSE_S = 0.01
    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (130, "")


def test_a_connection_that_does_not_close_ends_with_ctrl_c() -> None:
    program = """
    def work():
        interrupts.interruption.add_close(threading.Event().wait)
        ctrl_c_and_wait()
        return 0

    interrupts.CLOSE_S = 0.01
    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (130, "")


def test_ctrl_c_closes_the_connections_and_waits_for_the_work() -> None:
    program = """
    closed = threading.Event()

    def work():
        interrupts.interruption.add_close(closed.set)
        ctrl_c_and_wait()
        closed.wait()
        print("unwound", flush=True)
        return 0

    interrupts.CLOSE_S = 1000
    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (130, "unwound\n")


def test_a_second_ctrl_c_ends_the_work_immediately() -> None:
    program = f"""
    def work():
        interrupts.interruption.add_close(ctrl_c)
        ctrl_c_and_wait()
        threading.Event().wait()

    interrupts.CLOSE_S = {FOREVER}
    interrupts.run_interruptibly(work)
    """
    assert ended(program) == (130, "")


def test_work_continues_if_ctrl_c_is_ignored() -> None:
    program = """
    def work():
        ctrl_c()
        return 0

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (0, "")


def test_sigterm_is_the_regular_end_of_work_also_if_ctrl_c_is_ignored() -> None:
    program = """
    def work():
        stopped = threading.Event()
        interrupts.interruption.set_regular_end(stopped.set, 1000)
        os.kill(os.getpid(), signal.SIGTERM)
        stopped.wait()
        return 3

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (3, "")


def test_sigterm_ends_work_without_a_regular_end_as_usual() -> None:
    program = """
    def work():
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait()

    interrupts.run_interruptibly(work)
    """
    assert ended(program) == (-signal.SIGTERM, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_ending_gets_only_one_keyboard_interrupt(number: signal.Signals) -> None:
    program = f"""
    try:
        with interrupts.unwinding(signal.SIGINT, signal.SIGTERM):
            os.kill(os.getpid(), {number.value})
            threading.Event().wait()
    except KeyboardInterrupt:
        print("unwound")
    """
    assert ended(program) == (0, "unwound\n")


def test_an_interrupt_that_a_weakref_callback_swallows_still_ends_the_process() -> None:
    program = """
    class Dropped: pass

    with interrupts.unwinding(signal.SIGINT, limit_s=0.01):
        dropped = Dropped()
        told = weakref.ref(dropped, lambda _: ctrl_c())
        del dropped
        threading.Event().wait()
    """
    status, output = ended(program)
    assert status == 130
    assert "Traceback" not in output or "Exception ignored" in output


def test_a_second_ctrl_c_ends_the_cleanup_immediately() -> None:
    program = f"""
    with interrupts.unwinding(signal.SIGINT, limit_s={FOREVER}):
        try:
            ctrl_c()
        finally:
            ctrl_c()
            threading.Event().wait()
    """
    assert ended(program) == (130, "")


def test_a_service_that_is_still_loaded_ends_immediately() -> None:
    program = """
    with interrupts.ended_immediately():
        ctrl_c()
        threading.Event().wait()
    """
    assert ended(program) == (130, "")


def test_a_connection_that_opens_after_ctrl_c_is_closed_immediately_so_the_command_begins_nothing_more() -> None:
    program = """
    def work():
        ctrl_c_and_wait()
        closed = threading.Event()
        interrupts.interruption.add_close(closed.set)
        print("closed" if closed.is_set() else "goes on")
        return 0

    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (130, "closed\n")


def test_a_connection_that_opens_after_the_regular_end_was_asked_for_stays_open() -> None:
    program = """
    def work():
        interrupts.interruption.set_regular_end(lambda: None, 10)
        ctrl_c_and_wait()
        closed = threading.Event()
        interrupts.interruption.add_close(closed.set)
        print("closed" if closed.is_set() else "goes on")
        return 3

    sys.exit(interrupts.run_interruptibly(work))
    """
    assert ended(program) == (3, "goes on\n")
