"""Other threads look at the objects of a loop only between two of its steps, and never keep the loop from going on."""

from __future__ import annotations

import asyncio
import signal
import threading

from stampede_rt_channel_host.turns import LoopTurns

STEPS, LOOKS = 300, 50


def test_a_thread_sees_only_complete_steps_and_repeated_looks_do_not_stop_the_loop() -> None:
    turns, ended = LoopTurns(), threading.Event()
    state = [0, 0]
    looks: list[bool] = []

    async def change() -> None:
        number = 0
        while number < STEPS or len(looks) < LOOKS:  # a thread may be slow to begin
            number += 1
            state[0] = number
            sum(range(2000))  # Python may switch to another thread here
            state[1] = number
            await asyncio.sleep(0)

    def run() -> None:
        with asyncio.Runner(loop_factory=turns.loop) as runner:
            runner.run(change())
        turns.loop_ended()
        ended.set()

    loop = threading.Thread(target=run)
    loop.start()
    while not ended.is_set():
        turns.let_loop_run()
        with turns.lock:
            looks.append(state[0] == state[1])
    loop.join()
    assert all(looks)
    assert state[0] == state[1] >= STEPS


def test_after_the_end_of_the_loop_no_call_waits_for_it() -> None:
    turns = LoopTurns()
    with asyncio.Runner(loop_factory=turns.loop) as runner:
        runner.run(asyncio.sleep(0))
    turns.loop_ended()
    with turns.lock:
        pass


def test_a_call_knows_whether_it_interrupts_a_step_of_the_loop_or_a_look() -> None:
    turns = LoopTurns()

    async def step() -> bool:
        return turns.is_mine

    with asyncio.Runner(loop_factory=turns.loop) as runner:
        assert runner.run(step())
    turns.loop_ended()
    assert not turns.is_mine
    with turns.lock:
        assert turns.is_mine


def test_a_signal_handler_looks_while_its_thread_looks() -> None:
    turns = LoopTurns()
    looked: list[bool] = []

    def look(number: int, frame: object) -> None:
        looked.append(turns.lock.acquire(blocking=False))
        turns.lock.release()

    former = signal.signal(signal.SIGUSR1, look)
    try:
        with turns.lock:
            signal.raise_signal(signal.SIGUSR1)
    finally:
        signal.signal(signal.SIGUSR1, former)
    assert looked == [True]
