"""Ctrl-C in commands.

Python's own handler raises KeyboardInterrupt at any place in the main thread. Inside gRPC or `threading` the thread may
just have taken a lock, and not yet be inside the `with` block that releases the lock. No code then releases this lock,
and the code that later closes the connection waits for it for ever. If the exception comes in a weakref callback,
Python drops it. Therefore a command runs on another thread. The main thread only waits, and its handler raises nothing.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Any, NoReturn

from stampede_rt.cli.exit_statuses import INTERRUPTED

CLOSE_S = 2.0  # the time that a command has after Ctrl-C to close its connections and end
CLOSE_AFTER_STOP_S = 1.0  # instead of CLOSE_S, if a command with a regular end has used up its time
LOOK_S = 0.2  # how often the main thread looks for Ctrl-C
UNWIND_S = 20.0  # the time that a command in `unwinding` has to stop its processes
_ENDS = (signal.SIGTERM, signal.SIGHUP)  # the signals that are like Ctrl-C for a command with a regular end


class Interruption:
    """Knows whether the user has pressed Ctrl-C (`requested`), and which functions to call after Ctrl-C.

    SIGTERM and SIGHUP count as Ctrl-C while the command has a regular end. Otherwise they end the process as usual.
    """

    def __init__(self) -> None:
        self.requested = False
        self._closes: list[Callable[[], object]] = []
        self.regular_end: tuple[Callable[[], object], float] | None = None

    def set_regular_end(self, stop: Callable[[], object], limit_s: float) -> None:
        """Make Ctrl-C the regular end of the command: Ctrl-C then calls `stop`, and the command returns its own status.

        If the command has not ended `limit_s` seconds later, the process ends with INTERRUPTED, as after Ctrl-C in
        other commands.
        """
        self.regular_end = (stop, limit_s)

    def add_close(self, close: Callable[[], object]) -> None:
        """Keep the function `close`. After Ctrl-C a separate thread calls it.

        If Ctrl-C came before and the command has no regular end, calls `close` immediately, because the command must
        not use the connection that it has just opened.
        """
        self._closes.append(close)
        if self.requested and self.regular_end is None:
            self.close()

    def close(self) -> None:
        """Call all functions that `add_close` has kept, the latest first, and forget them."""
        while self._closes:
            with suppress(Exception):  # the process ends in any case
                self._closes.pop()()

    def begin(self) -> None:
        """Forget the Ctrl-C and the functions of the previous command."""
        self.requested = False
        self._closes.clear()
        self.regular_end = None


interruption = Interruption()


def run_interruptibly(work: Callable[[], int]) -> int:
    """Run `work` on a separate thread and return its exit status. After Ctrl-C the process ends with INTERRUPTED.

    A command with a regular end (`set_regular_end`) has its own status if it ends in time. SIGTERM and SIGHUP end it in
    the same way, because service managers, scripts and closed terminals send these signals.

    After Ctrl-C this function closes the command's connections, and waits for the end of `work`. Both together
    take at most CLOSE_S. A command with a regular end first has `limit_s` to end, and then CLOSE_AFTER_STOP_S. A
    second Ctrl-C ends the process immediately. Only the main thread receives signals. If the caller is another thread,
    or if the process ignores all these signals, `work` runs on the caller's thread.
    """
    handled = [one for one in (*_ENDS, signal.SIGINT) if signal.getsignal(one) is not signal.SIG_IGN]
    if threading.current_thread() is not threading.main_thread() or not handled:
        return work()
    interruption.begin()
    events: SimpleQueue[Any] = SimpleQueue()  # `put` is safe inside a signal handler

    def interrupt(number: int, frame: object) -> None:
        if number in _ENDS and interruption.regular_end is None:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        elif interruption.requested:
            os._exit(INTERRUPTED)
        else:
            interruption.requested = True
            events.put(None)

    before = {one: signal.signal(one, interrupt) for one in handled}
    try:
        _begin(work, events)
        outcome, limit_s = _next(events), CLOSE_S
        if outcome is None and interruption.regular_end is not None:
            outcome, limit_s = _stopped(*interruption.regular_end, events), CLOSE_AFTER_STOP_S
        if outcome is None:
            _close(events, limit_s)
        return int(outcome())
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _next(events: SimpleQueue[Any]) -> Any:
    """Return the next event. Looks every LOOK_S, because a signal may wake another thread instead."""
    while True:
        with suppress(Empty):
            return events.get(timeout=LOOK_S)


def _stopped(stop: Callable[[], object], limit_s: float, events: SimpleQueue[Any]) -> Any:
    """Call `stop` on a thread of its own, and return the next event; None after `limit_s` seconds."""
    threading.Thread(target=stop, name="stampede stop", daemon=True).start()
    until_s = time.monotonic() + limit_s
    while (left_s := until_s - time.monotonic()) > 0:
        with suppress(Empty):
            return events.get(timeout=min(LOOK_S, left_s))
    return None


def _begin(work: Callable[[], int], events: SimpleQueue[Any]) -> None:
    """Start `work` on a thread. At its end `events` gets a function that returns its status or raises its error."""

    def run() -> None:
        try:
            status = work()
        except BaseException as error:  # noqa: BLE001  # SystemExit is a result of the command, too
            events.put(_raising(error))
        else:
            events.put(lambda: status)

    threading.Thread(target=run, name="stampede command", daemon=True).start()


def _raising(error: BaseException) -> Callable[[], int]:
    def fail() -> int:
        raise error

    return fail


def _close(events: SimpleQueue[Any], limit_s: float) -> NoReturn:
    """Close the connections, wait for the work and its output, and end the process. Blocks for at most `limit_s`.

    A normal end of the interpreter would hang: it waits for locks whose holders, threads of gRPC, no longer run.
    """
    closed: SimpleQueue[None] = SimpleQueue()

    def close() -> None:
        interruption.close()
        events.get()
        with suppress(OSError):  # no process reads the output any more
            sys.stdout.flush()
        closed.put(None)

    threading.Thread(target=close, name="stampede close", daemon=True).start()
    with suppress(Empty):
        closed.get(timeout=limit_s)
    os._exit(INTERRUPTED)


@contextmanager
def ended_immediately() -> Iterator[None]:
    """Let Ctrl-C end the process immediately while a service loads. The service then installs its own handlers."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, _exit)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is _exit:
            signal.signal(signal.SIGINT, before)


@contextmanager
def unwinding(*numbers: signal.Signals, limit_s: float = UNWIND_S) -> Iterator[None]:
    """Raise KeyboardInterrupt at the first of these signals, for a command that must stop processes.

    If the `with` block has not ended `limit_s` seconds after the first signal, the process ends, even if Python has
    dropped the exception. A second signal ends the process immediately.
    """
    signals: list[int] = []

    def interrupt(number: int, frame: object) -> None:
        if signals:
            os._exit(INTERRUPTED)
        signals.append(number)
        signal.signal(signal.SIGALRM, _exit)
        signal.setitimer(signal.ITIMER_REAL, limit_s)  # a thread would need locks, and this handler must not take locks
        raise KeyboardInterrupt

    before = {number: signal.getsignal(number) for number in numbers}
    overdue = signal.getsignal(signal.SIGALRM)
    for number in numbers:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        if signals:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, overdue)
        for number, handler in before.items():
            signal.signal(number, handler)


def _exit(number: int, frame: object) -> None:
    os._exit(INTERRUPTED)
