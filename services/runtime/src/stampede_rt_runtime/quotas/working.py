"""The work of a stream or call on its event loop. The work counts for the caller, and waits for the caller's turn."""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
import time
from collections.abc import Callable, Coroutine, Generator, Iterator
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.loop_shares import LoopShare, LoopShares

CALL_NANOS = 400_000
"""The approximate time that a call takes outside of its measured steps, over gRPC and over a socket."""
LONG_BYTES = 4096
SCHEDULER_STATISTICS = Path("/proc/thread-self/schedstat")
ASK_NANOS = 10_000_000  # the interval between two looks at the scheduler's statistics

Result = TypeVar("Result")


class TransportCosts(NamedTuple):
    """The approximate time that a transport takes outside of the measured steps, to read a message and to write one.

    `kib_nanos`: the further time for each KiB that was read, if a message is longer than LONG_BYTES.
    """

    read_nanos: int
    write_nanos: int
    kib_nanos: int


GRPC_COSTS = TransportCosts(40_000, 250_000, 1024)
"""With grpcio 1.85.1, 262,000 bytes took 0.4 ms, and 200 bytes 0.03 ms, with the time on gRPC's own threads."""
SOCKET_COSTS = TransportCosts(8_000, 8_000, 400)
"""A message of 100 bytes and its echo took 11 us, and 250,000 bytes and their echo 101 us."""


def costs_of(context: object) -> TransportCosts:
    """The costs of the transport of a call. A context that names no costs is gRPC's."""
    found: TransportCosts = getattr(context, "costs", GRPC_COSTS)
    return found


def loop_shares() -> LoopShares:
    """The shares of callers in the time of the running event loop."""
    return LoopShares(usable_time(), _schedule)


def usable_time(
    clock: Callable[[], int] = time.monotonic_ns, waited_nanos: Callable[[], int] | None = None
) -> Callable[[], int]:
    """A clock, in nanoseconds, of the time that the calling thread can use.

    The clock stops while the thread waits for a processor because other programs run. So a caller's percentage applies
    to the time that the thread really gets. `waited_nanos`: returns how long the thread has waited so far; None: the
    clock asks the system.
    """
    ask = waited_nanos or _waited_nanos
    now = waited = ask_again_at = 0

    def read() -> int:
        nonlocal now, waited, ask_again_at
        passed = clock()
        if passed >= ask_again_at:
            # A failed reading gives 0, for example while no file descriptor is left. The former value then remains.
            waited, ask_again_at = max(waited, ask()), passed + ASK_NANOS
        now = max(now, passed - waited)
        return now

    return read


class _OpenFile:
    """The scheduler's statistics of the calling thread, in a file that stays open because it takes 15 us to open it."""

    def __init__(self) -> None:
        self.number = -1
        with contextlib.suppress(OSError):
            self.number = os.open(SCHEDULER_STATISTICS, os.O_RDONLY | os.O_CLOEXEC)

    def __del__(self) -> None:
        if self.number >= 0:
            os.close(self.number)


class _Statistics(threading.local):
    @cached_property
    def file(self) -> _OpenFile:
        # The file is opened at the first use. So a forked process opens a file of its own, with its own statistics.
        return _OpenFile()


_statistics = _Statistics()


def _waited_nanos() -> int:
    """The time in nanoseconds that this thread was ready and had no processor. 0 if the system does not say it."""
    try:
        return int(os.pread(_statistics.file.number, 256, 0).split()[1])
    except (OSError, ValueError, IndexError):
        return 0


def _schedule(delay_s: float, call: Callable[[], None]) -> object:
    loop = asyncio.get_running_loop()
    return loop.call_later(delay_s, call) if delay_s else loop.call_soon(call)


class CallerWork:
    """The work of one stream or call. Before a step with much work: `if work.must_wait: await work.turn()`."""

    __slots__ = ("_costs", "_loop_share")

    def __init__(self, account: Account, costs: TransportCosts = GRPC_COSTS) -> None:
        self._loop_share, self._costs = account.loop_share, costs

    @property
    def must_wait(self) -> bool:
        """Whether the next step must wait for its caller's turn."""
        return self._loop_share is not None and self._loop_share.must_wait

    async def turn(self) -> None:
        """Wait for the caller's turn."""
        assert self._loop_share is not None, "an account without turns never waits"
        turn_begins: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._loop_share.enqueue(partial(_set_unless_done, turn_begins))
        await turn_begins

    def spend(self, nanos: int) -> None:
        """Count time that passes outside of the measured steps."""
        if self._loop_share is not None:
            self._loop_share.spend(nanos)

    def spend_read(self) -> None:
        """Count, at the end of the present step, the time that the transport takes to read a message."""
        if self._loop_share is not None:
            self._loop_share.spend_later(self._costs.read_nanos)

    def spend_write(self) -> None:
        """Count, at the end of the present step, the time that the transport takes to write a message."""
        if self._loop_share is not None:
            self._loop_share.spend_later(self._costs.write_nanos)

    def spend_bytes(self, count: int) -> None:
        """Count the time that the transport takes to read a number of bytes."""
        self.spend(count * self._costs.kib_nanos >> 10)

    def received(self, message: Any) -> None:
        """Count the time that the transport took to read the bytes of a long message."""
        if self._loop_share is not None and isinstance(message, bytes | memoryview) and len(message) > LONG_BYTES:
            self.spend_bytes(len(message))


def charged(account: Account, work: Coroutine[Any, Any, Result]) -> Coroutine[Any, Any, Result]:
    """A coroutine that runs `work`. Each of its steps, from one wait to the next, counts for the account."""
    return work if account.loop_share is None else _ChargedCoroutine(account.loop_share, work)


class _ChargedCoroutine(Coroutine[Any, Any, Result]):
    """Runs a coroutine, and measures the processor time of each step. The measurement takes about a microsecond.

    Elapsed time would include the work of other threads, and would charge it to the caller.

    This is no `async def` function, so that a cancellation before the first step of the task also reaches `work`.
    """

    __slots__ = ("_loop_share", "_work")

    def __init__(self, loop_share: LoopShare, work: Coroutine[Any, Any, Result]) -> None:
        self._loop_share = loop_share
        self._work = work

    def send(self, value: Any) -> Any:
        """One step. Raises StopIteration with the result at the end."""
        began_at = time.thread_time_ns()
        try:
            return self._work.send(value)
        finally:
            self._loop_share.spend(time.thread_time_ns() - began_at)

    def throw(self, *error: Any) -> Any:
        """One step, which begins with an error, such as a cancellation."""
        began_at = time.thread_time_ns()
        try:
            return self._work.throw(*error)
        finally:
            error = ()  # otherwise the error references this frame, and this frame references the error
            self._loop_share.spend(time.thread_time_ns() - began_at)

    def close(self) -> None:
        """End the work where it waits."""
        self._work.close()

    def __await__(self) -> Generator[Any, Any, Result]:
        return self  # type: ignore[return-value]  # it has the methods of a generator

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        return self.send(None)


def _set_unless_done(turn_begins: asyncio.Future[None]) -> None:
    """Wake the waiting step, unless it was cancelled."""
    if not turn_begins.done():
        turn_begins.set_result(None)
