"""Runs a host's registration on a thread and an event loop of its own (decision 0060).

If something blocks the loop that serves channels, renewals still continue, and the fence still comes in time. A loop
that has run no callback for LOOP_SILENCE_SECONDS_MAX serves no caller. Then the renewals stop, too, and the directory
may give the channels to other hosts.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, NoReturn, TypeVar

from stampede_rt.values.peering import ClockOffset
from stampede_rt_channel_host.cluster.registration import START_SECONDS_MAX, Registration

logger = logging.getLogger(__name__)

LOOP_SILENCE_SECONDS_MAX = 60.0
LOOP_LATE_SECONDS = 1.0
"""If the loop performs a call later than this, the host logs a warning."""
STOP_SECONDS_MAX = 5.0  # the time that `leave` waits for the end of the thread

Result = TypeVar("Result")


class ServingLoop:
    """The loop that serves channels, as the lease's thread sees it. All methods are called on the lease's thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._scheduled_s: float | None = None  # when `has_hung` scheduled `_note_running`; None: that call has run

    def run_soon(self, call: Callable[[], None]) -> None:
        """Run `call` on the serving loop, after all earlier calls of this method. Does not wait."""
        self._loop.call_soon_threadsafe(call)

    async def run(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Do `work` on the serving loop, and wait until it is done. Raises the errors of `work`."""
        await _on(self._loop, work())

    def has_hung(self) -> bool:
        """Whether the serving loop has run no callback for LOOP_SILENCE_SECONDS_MAX.

        Schedules a callback on the loop. If the callback of an earlier call has not run yet, looks how long it has
        waited.
        """
        now_s, scheduled_s = time.monotonic(), self._scheduled_s  # read once: the other thread sets it
        if scheduled_s is not None:
            return now_s - scheduled_s > LOOP_SILENCE_SECONDS_MAX
        self._scheduled_s = now_s
        self._loop.call_soon_threadsafe(self._note_running, now_s)
        return False

    def _note_running(self, scheduled_s: float) -> None:
        """The callback that `has_hung` schedules: notes that the loop runs. Runs on the serving loop's own thread."""
        late_s = time.monotonic() - scheduled_s
        if late_s > LOOP_LATE_SECONDS:
            logger.warning(
                "the event loop that serves channels was blocked",
                extra={"event": "event_loop_blocked", "seconds": round(late_s, 3)},
            )
        self._scheduled_s = None


class LeaseThread:
    """One host's place in the directory, kept on a thread of its own.

    Create the object on the loop that serves channels. Call `enter`, `keep` and `leave` on that loop, in this order.
    Any thread may call `lease_held`, `fenced_in_nanos` and `clock`. `make` gets the serving loop and makes the
    registration. The registration must pass all work on channels to the serving loop.
    """

    def __init__(self, make: Callable[[ServingLoop], Registration]) -> None:
        self._make = make
        self._registration: Registration | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._ended = asyncio.Event()  # the thread has ended

    def lease_held(self) -> bool:
        """Whether the host may serve its channels now."""
        return self._registration is not None and self._registration.lease_held()

    def fenced_in_nanos(self) -> int:
        """The time in nanoseconds that the host may still serve without a renewal; 0 if it may not serve."""
        return 0 if self._registration is None else self._registration.fenced_in_nanos()

    def clock(self) -> ClockOffset | None:
        """How far this host's clock is ahead of the leader's, as of the last renewal; None before that."""
        return None if self._registration is None else self._registration.clock

    def fence_boottime(self) -> int:
        """Until when the host may serve, in nanoseconds of CLOCK_BOOTTIME; 0 if it may not."""
        return 0 if self._registration is None else self._registration.fence_boottime()

    async def enter(self, target: str, timeout_s: float = START_SECONDS_MAX) -> None:
        """See `Registration.enter`."""
        registration, loop = self._started()
        await _on(loop, registration.enter(target, timeout_s))

    async def keep(self) -> NoReturn:
        """See `Registration.keep`."""
        registration, loop = self._started()
        await _on(loop, registration.keep())
        raise AssertionError("keep never returns")

    async def leave(self) -> None:
        """See `Registration.leave`. Then ends the thread. Idempotent. Does nothing for a host that never entered."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        registration, loop = self._started()
        try:
            await _on(loop, registration.leave())
            await _on(loop, registration.aclose())
        finally:
            loop.call_soon_threadsafe(loop.stop)
            # a helper thread cannot wait here: an interpreter that is ending starts no thread
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(STOP_SECONDS_MAX):
                    await self._ended.wait()

    def _started(self) -> tuple[Registration, asyncio.AbstractEventLoop]:
        if self._registration is None or self._loop is None:
            serving = asyncio.get_running_loop()
            self._registration = self._make(ServingLoop(serving))
            self._loop = asyncio.new_event_loop()
            end = partial(serving.call_soon_threadsafe, self._ended.set)
            self._thread = threading.Thread(target=_run_loop, args=(self._loop, end), name="lease", daemon=True)
            self._thread.start()
        return self._registration, self._loop


def _run_loop(loop: asyncio.AbstractEventLoop, tell_end: Callable[[], object]) -> None:
    """Run the loop until another thread stops it; then cancel its tasks, close it, and call `tell_end`."""
    asyncio.set_event_loop(loop)
    try:
        loop.run_forever()
    finally:
        unfinished_tasks = asyncio.all_tasks(loop)
        for task in unfinished_tasks:
            task.cancel()
        loop.run_until_complete(asyncio.gather(*unfinished_tasks, return_exceptions=True))
        loop.close()
        with contextlib.suppress(RuntimeError):  # the serving loop has been closed
            tell_end()


async def _on(loop: asyncio.AbstractEventLoop, work: Coroutine[Any, Any, Result]) -> Result:
    """Do `work` on another thread's loop. If the caller is cancelled, `work` is cancelled, too."""
    return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(work, loop))
