"""The work of a stream or call on its event loop. It counts for its caller, and waits for the turn of its caller."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine, Generator, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.turns import Turn, Turns

READ_NANOS = 40_000
WRITE_NANOS = 250_000
CALL_NANOS = 400_000
"""The approximate time that gRPC takes to read a message, to write a message, and for a call. The measured steps do not
contain this time.
"""
LONG_BYTES = 4096
NANOS_PER_BYTE = 1
"""The further time for each byte of a message that is longer than LONG_BYTES.

With grpcio 1.85.1, a message of 262,000 bytes took 0.4 ms, and one of 200 bytes 0.03 ms.
"""
SCHEDULER_STATISTICS = Path("/proc/thread-self/schedstat")
ASK_NANOS = 10_000_000  # the interval between two looks at the scheduler's statistics, each of which takes about 20 us

Result = TypeVar("Result")


def loop_turns() -> Turns:
    """The turns of the callers of the running event loop."""
    return Turns(usable_time(), _schedule)


def usable_time(
    clock: Callable[[], int] = time.monotonic_ns, waited_nanos: Callable[[], int] | None = None
) -> Callable[[], int]:
    """A clock, in nanoseconds, of the time that the calling thread can use.

    It stands still while the thread waits for a processor, because other programs run. So a share of this time is a
    share of what the thread gets. `waited_nanos`: how long the thread has waited so far; None: ask the system.
    """
    ask = waited_nanos or _waited_nanos
    now = waited = ask_again_at = 0

    def read() -> int:
        nonlocal now, waited, ask_again_at
        passed = clock()
        if passed >= ask_again_at:
            # A failed look gives 0, for example while no file descriptor is left. The former value then stays.
            waited, ask_again_at = max(waited, ask()), passed + ASK_NANOS
        now = max(now, passed - waited)
        return now

    return read


def _waited_nanos() -> int:
    """How long this thread was ready and had no processor, in nanoseconds. 0 if the system does not say it."""
    try:
        return int(SCHEDULER_STATISTICS.read_bytes().split()[1])
    except (OSError, ValueError, IndexError):
        return 0


def _schedule(delay_s: float, call: Callable[[], None]) -> object:
    loop = asyncio.get_running_loop()
    return loop.call_later(delay_s, call) if delay_s else loop.call_soon(call)


class CallerWork:
    """The work of one stream or call. Before a step with much work: `if work.must_wait: await work.turn()`."""

    __slots__ = ("_turn",)

    def __init__(self, account: Account) -> None:
        self._turn = account.turn

    @property
    def must_wait(self) -> bool:
        """Whether the next step must wait for its caller's turn."""
        return self._turn is not None and self._turn.must_wait

    async def turn(self) -> None:
        """Wait for the caller's turn."""
        assert self._turn is not None, "an account without turns never waits"
        came: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._turn.stand(partial(_set_unless_done, came))
        await came

    def spend(self, nanos: int) -> None:
        """Count time that gRPC takes for the caller: READ_NANOS, WRITE_NANOS or CALL_NANOS."""
        if self._turn is not None:
            self._turn.spend(nanos)

    def received(self, message: Any) -> None:
        """Count the time that the bytes of a long message took, before the stream or call does anything with it."""
        if self._turn is not None and isinstance(message, bytes) and len(message) > LONG_BYTES:
            self._turn.spend(len(message) * NANOS_PER_BYTE)


def charged(account: Account, work: Coroutine[Any, Any, Result]) -> Coroutine[Any, Any, Result]:
    """A coroutine that runs `work`. Each of its steps, from one wait to the next, counts for the account."""
    return work if account.turn is None else _Charged(account.turn, work)


class _Charged(Coroutine[Any, Any, Result]):
    """Runs a coroutine, and measures the processor time of each step. The measurement takes about a microsecond.

    A clock would count the time, too, in which the system ran other threads, and hold up a caller that used little.

    It is no `async def` function: if its task is cancelled before the first step, the cancellation reaches `work`.
    """

    __slots__ = ("_turn", "_work")

    def __init__(self, turn: Turn, work: Coroutine[Any, Any, Result]) -> None:
        self._turn = turn
        self._work = work

    def send(self, value: Any) -> Any:
        """One step. Raises StopIteration with the result at the end."""
        began_at = time.thread_time_ns()
        try:
            return self._work.send(value)
        finally:
            self._turn.spend(time.thread_time_ns() - began_at)

    def throw(self, *error: Any) -> Any:
        """One step, which begins with an error, such as a cancellation."""
        began_at = time.thread_time_ns()
        try:
            return self._work.throw(*error)
        finally:
            error = ()  # else the error's traceback keeps this frame, and this frame the error
            self._turn.spend(time.thread_time_ns() - began_at)

    def close(self) -> None:
        """End the work where it waits."""
        self._work.close()

    def __await__(self) -> Generator[Any, Any, Result]:
        return self  # type: ignore[return-value]  # it has the methods of a generator

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        return self.send(None)


def _set_unless_done(came: asyncio.Future[None]) -> None:
    """Wake the waiting step, unless it was cancelled."""
    if not came.done():
        came.set_result(None)
