"""An event loop in virtual time: while all tasks wait, the clock jumps to the next timer.

A run of minutes takes milliseconds, and the same seed gives the same run. `asyncio.to_thread` does its work on the
loop. The tasks must not use other threads in any other way.
"""

from __future__ import annotations

import asyncio
import random
import selectors
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar
from unittest.mock import patch

Result = TypeVar("Result")
_START_UNIX_NANO = 1_700_000_000 * 10**9


class VirtualClock:
    """A HostClock, and the monotonic clock of the process."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def monotonic_ns(self) -> int:
        return round(self.now_s * 1e9)

    boottime_nanos = monotonic_ns

    def time_unix_nano(self) -> int:
        return _START_UNIX_NANO + self.monotonic_ns()


class _JumpingSelector(selectors.DefaultSelector):
    """Moves the clock instead of waiting. It does not look at files: the tasks use none."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout: float | None = None) -> Any:
        if timeout is None:
            raise AssertionError("all tasks wait for ever")
        self._clock.now_s += timeout
        return []


@contextmanager
def _in_place_of(function: Callable[..., Any], clock: VirtualClock) -> Iterator[None]:
    """Replace each default argument of the function that is a real clock by the virtual clock."""
    virtual = {time.monotonic: clock.monotonic, time.monotonic_ns: clock.monotonic_ns}

    def shown(one: Any) -> Any:
        return virtual.get(one, one) if callable(one) else one

    method: Any = function
    before = method.__defaults__, method.__kwdefaults__
    method.__defaults__ = tuple(map(shown, before[0] or ()))
    method.__kwdefaults__ = {name: shown(one) for name, one in (before[1] or {}).items()}
    try:
        yield
    finally:
        method.__defaults__, method.__kwdefaults__ = before


async def _on_the_loop(work: Callable[..., Any], *arguments: Any) -> Any:
    """Like `asyncio.to_thread`, but in a later turn of the loop."""
    await asyncio.sleep(0)
    return work(*arguments)


def run_virtually(
    main: Callable[[VirtualClock], Coroutine[Any, Any, Result]], seed: int, *with_clocks: Callable[..., Any]
) -> Result:
    """Run `main` in virtual time. `with_clocks`: functions with clocks of the process as defaults.

    `seed` also seeds the module `random`. Raises AssertionError if all tasks wait for ever.
    """
    clock, state = VirtualClock(), random.getstate()
    random.seed(seed)
    try:
        with ExitStack() as patches:
            for function in with_clocks:
                patches.enter_context(_in_place_of(function, clock))
            patches.enter_context(patch.object(time, "monotonic", clock.monotonic))
            patches.enter_context(patch.object(time, "monotonic_ns", clock.monotonic_ns))
            patches.enter_context(patch.object(asyncio, "to_thread", _on_the_loop))
            with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(_JumpingSelector(clock))) as runner:
                return runner.run(main(clock))
    finally:
        random.setstate(state)
