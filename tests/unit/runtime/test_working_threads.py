"""Threads that work until they are shut down, also after the main thread has ended."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from concurrent.futures import CancelledError

import pytest

from stampede_rt_runtime.working_threads import WorkingThreads

LIMIT_S = 60


def test_calls_have_results_and_errors() -> None:
    threads = WorkingThreads(2, "test")
    assert threads.submit(divmod, 7, 2).result(LIMIT_S) == (3, 1)
    with pytest.raises(ZeroDivisionError):
        threads.submit(divmod, 7, 0).result(LIMIT_S)
    assert threads.submit(int, "11", base=2).result(LIMIT_S) == 3
    threads.shutdown()
    with pytest.raises(RuntimeError, match="test have been shut down"):
        threads.submit(divmod, 7, 2)


def test_as_many_calls_run_at_the_same_time_as_there_are_threads() -> None:
    threads, met = WorkingThreads(3, "test"), threading.Barrier(3)
    assert sorted(one.result(LIMIT_S) for one in [threads.submit(met.wait, LIMIT_S) for _ in range(3)]) == [0, 1, 2]
    threads.shutdown()


def test_one_thread_performs_calls_in_order_and_a_shutdown_lets_it_end_them() -> None:
    threads, seen, may_continue = WorkingThreads(1, "test"), list[int](), threading.Event()
    threads.submit(may_continue.wait, LIMIT_S)
    for number in range(100):
        threads.submit(seen.append, number)
    cancelled = threads.submit(seen.append, -1)
    assert cancelled.cancel()
    threads.shutdown(wait=False)
    may_continue.set()
    threads.shutdown()
    assert seen == [*range(100)]


def test_a_shutdown_may_leave_out_the_calls_that_wait() -> None:
    threads, may_continue, begun = WorkingThreads(1, "test"), threading.Event(), threading.Event()
    running = threads.submit(lambda: (begun.set(), may_continue.wait(LIMIT_S)))
    assert begun.wait(LIMIT_S)
    waiting = threads.submit(divmod, 7, 2)
    threads.shutdown(wait=False, cancel_futures=True)
    may_continue.set()
    assert running.result(LIMIT_S)[1]
    with pytest.raises(CancelledError):
        waiting.result(LIMIT_S)


async def test_an_event_loop_can_use_working_threads_as_its_default_executor() -> None:
    asyncio.get_running_loop().set_default_executor(WorkingThreads(1, "default"))
    assert await asyncio.to_thread(threading.current_thread) is not threading.main_thread()


def test_working_threads_run_after_the_main_thread_has_ended_and_do_not_keep_the_program_alive() -> None:
    source = """
import threading
from stampede_rt_runtime.working_threads import WorkingThreads
threads = WorkingThreads(2, "test")
def work():
    threading.main_thread().join()
    print(threads.submit(divmod, 7, 2).result(60))
    threads.submit(threading.Event().wait)
threading.Thread(target=work).start()
"""
    run = subprocess.run([sys.executable, "-c", source], capture_output=True, timeout=LIMIT_S, check=True, text=True)
    assert (run.stdout, run.stderr) == ("(3, 1)\n", "")
