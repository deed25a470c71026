"""The blocking client's waits, while signals come."""

from __future__ import annotations

import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from types import FrameType

import pytest

from stampede_rt.transports.concurrency_sync import BackgroundTask, Signal, Steps


class Interrupted(BaseException):
    """Raised by the handler of the test, as Python's own handler of Ctrl-C raises KeyboardInterrupt."""


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    def interrupt(number: int, frame: FrameType | None) -> None:
        raise Interrupted

    before = signal.signal(signal.SIGUSR1, interrupt)
    yield
    signal.signal(signal.SIGUSR1, before)


def is_waiting(thread: threading.Thread) -> bool:
    """Whether the thread has come from `wait_in_parts` to the wait for a lock."""
    frame: FrameType | None = sys._current_frames()[thread.ident or 0]
    names = []
    while frame is not None:
        names.append(frame.f_code.co_name)
        frame = frame.f_back
    return "wait_in_parts" in names[1:] and names[0] in ("_wait", "_wait_for_tstate_lock")


def interrupted_in(wait: Callable[[], object]) -> bool:
    """Whether a signal of the system ends `wait`.

    The test sends the signal to another thread while the main thread waits for a lock. So the signal does not wake the
    main thread. A signal that comes just before the wait does not wake it, either.
    """
    main = threading.main_thread()
    assert threading.current_thread() is main

    def send() -> None:
        while not is_waiting(main):
            pass
        signal.pthread_kill(threading.get_ident(), signal.SIGUSR1)

    sender = threading.Thread(target=send)
    try:
        sender.start()
        wait()
    except Interrupted:
        return True
    finally:
        sender.join()
    return False


@pytest.mark.parametrize("timeout_s", [None, 1000.0])
def test_a_signal_ends_a_wait_for_a_flag_though_no_thread_sets_the_flag(timeout_s: float | None) -> None:
    assert interrupted_in(lambda: Signal().wait(timeout_s))


def test_a_signal_ends_a_wait_for_the_end_of_a_task() -> None:
    release = threading.Event()
    task = BackgroundTask(lambda: release.wait() and None, "of the test")
    assert interrupted_in(lambda: task.join(1000.0))
    release.set()
    assert task.join(1000.0)


def test_a_wait_ends_with_its_timeout_or_with_the_flag_on_every_thread() -> None:
    found: list[bool] = []
    flag = Signal()

    def look() -> None:
        found.append(flag.wait(0.0))
        found.append(flag.wait(0.01))
        flag.set()
        found.append(flag.wait(None))
        flag.clear()

    look()
    other = threading.Thread(target=look)
    other.start()
    other.join()
    assert found == [False, False, True] * 2


def in_a_thread(call: Callable[[], object]) -> None:
    thread = threading.Thread(target=call)
    thread.start()
    thread.join(10)
    assert not thread.is_alive()


def test_a_step_that_interrupts_another_one_runs_after_it() -> None:
    steps, seen = Steps(), list[object]()

    def outer() -> None:
        seen.append(steps.is_interrupted)
        steps.run(seen.append, "inner")
        steps.offer(seen.append, "offered")
        seen.append("outer")

    steps.run(outer)
    assert seen == [True, "outer", "inner", "offered"]
    assert not steps.is_interrupted


def test_an_offered_step_does_not_wait_for_the_thread_that_runs_another_one() -> None:
    steps, seen = Steps(), list[str]()

    def outer() -> None:
        in_a_thread(lambda: steps.offer(seen.append, "offered"))
        assert not seen

    steps.run(outer)
    assert seen == ["offered"]


def test_a_step_waits_for_the_step_of_another_thread() -> None:
    steps, seen = Steps(), list[str]()
    inside, may_end = threading.Event(), threading.Event()

    def slow() -> None:
        inside.set()
        may_end.wait(10)
        seen.append("slow")

    first = threading.Thread(target=lambda: steps.offer(slow))
    first.start()
    assert inside.wait(10)
    second = threading.Thread(target=lambda: steps.run(seen.append, "next"))
    second.start()
    may_end.set()
    first.join(10)
    second.join(10)
    assert seen == ["slow", "next"]


class InterruptingSteps(deque[Callable[[], None]]):
    """Waiting steps. A signal handler runs a step just before the first of them is taken."""

    handle: Callable[[], None] | None = None

    def popleft(self) -> Callable[[], None]:
        handle, self.handle = self.handle, None
        if handle is not None:
            handle()
        return super().popleft()


def test_a_handler_that_runs_all_waiting_steps_leaves_none_to_the_interrupted_call() -> None:
    """In an earlier version, the interrupted call raised IndexError."""
    steps, seen, waiting = Steps(), list[str](), InterruptingSteps()
    steps._waiting = waiting
    waiting.handle = lambda: steps.run(seen.append, "of the handler")
    steps.offer(seen.append, "offered")
    assert seen == ["offered", "of the handler"]


def test_a_step_that_a_signal_ends_leaves_the_others_their_turn() -> None:
    steps, seen = Steps(), list[str]()

    def interrupted() -> None:
        steps.run(seen.append, "later")
        raise Interrupted

    with pytest.raises(Interrupted):
        steps.run(interrupted)
    steps.run(seen.append, "next")
    in_a_thread(lambda: steps.run(seen.append, "of another thread"))
    assert seen == ["later", "next", "of another thread"]


def test_a_set_flag_wakes_all_waiting_threads_and_each_later_wait_until_it_is_cleared() -> None:
    signals, woken = Signal(), list[bool]()
    waiting = [threading.Thread(target=lambda: woken.append(signals.wait(10))) for _ in range(5)]
    for one in waiting:
        one.start()
    signals.set()
    signals.set()
    for one in waiting:
        one.join(10)
    assert woken == [True] * 5
    assert signals.wait(0)
    signals.clear()
    signals.clear()
    assert not signals.wait(0)


def test_a_step_whose_caller_a_signal_ends_before_its_turn_never_runs() -> None:
    """In an earlier version, another thread ran such a step if an offered step was before it, although the put had
    raised.
    """
    steps, seen = Steps(), list[str]()
    inside, may_end = threading.Event(), threading.Event()

    def slow() -> None:
        inside.set()
        may_end.wait(10)

    first = threading.Thread(target=lambda: steps.offer(slow))
    first.start()
    assert inside.wait(10)
    in_a_thread(lambda: steps.offer(seen.append, "offered"))
    killer = threading.Timer(0.1, signal.pthread_kill, (threading.main_thread().ident, signal.SIGUSR1))
    killer.start()
    with pytest.raises(Interrupted):
        steps.run(seen.append, "of a put that has raised")
    may_end.set()
    first.join(10)
    killer.join(10)
    steps.run(seen.append, "next")
    assert seen == ["offered", "next"]


def test_a_call_returns_after_its_step_though_another_thread_runs_steps_meanwhile() -> None:
    """In an earlier version, the other thread took the step over, and the call returned before the end of the step."""
    steps, seen = Steps(), list[str]()
    inside, may_end, begun, returned = (threading.Event() for _ in range(4))

    class Watched(deque[Callable[[], None]]):
        def append(self, step: Callable[[], None]) -> None:
            super().append(step)
            if threading.current_thread() is threading.main_thread():  # loses the interpreter here
                may_end.set()
                begun.wait(10)

    def slow() -> None:
        inside.set()
        may_end.wait(10)

    def step() -> None:
        begun.set()
        returned.wait(0.05)
        seen.append("step")

    steps._waiting = Watched()
    first = threading.Thread(target=lambda: steps.offer(slow))
    first.start()
    assert inside.wait(10)
    in_a_thread(lambda: steps.offer(seen.append, "offered"))
    threading.Timer(0.1, may_end.set).start()
    steps.run(step)
    returned.set()
    assert seen == ["offered", "step"]
    first.join(10)


def test_a_flag_that_is_set_and_then_cleared_wakes_all_waiting_callers() -> None:
    """In an earlier version, such a flag woke only one of the waiting callers."""
    signals, woken = Signal(), list[bool]()
    waiting = [threading.Thread(target=lambda: woken.append(signals.wait(10))) for _ in range(5)]
    for one in waiting:
        one.start()
        while not is_waiting(one):
            pass
    signals.set()
    signals.clear()
    for one in waiting:
        one.join(20)
    assert woken == [True] * 5
    assert not signals.wait(0)


def test_a_waiting_caller_wakes_although_a_signal_handler_has_cleared_the_flag_again() -> None:
    """In an earlier version, a flush waited for its whole timeout if a signal handler flushed the same producer
    meanwhile.
    """
    signals = Signal()

    def handle(number: int, frame: FrameType | None) -> None:
        signals.set()
        signals.clear()
        assert not signals.wait(0)

    former = signal.signal(signal.SIGALRM, handle)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        assert signals.wait(5)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
