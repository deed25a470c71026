"""Runs the product's coroutines without an event loop, in simulated time and in an order that the seed decides."""

from __future__ import annotations

import types
from collections.abc import Callable, Coroutine, Generator
from typing import Any

Resume = Callable[[Any], None]
Start = Callable[[Resume], None]


@types.coroutine
def wait(start: Start) -> Generator[Start, Any, Any]:
    """Suspend the coroutine. `start` gets the function that resumes it once, with a value.

    `wait` returns this value.
    """
    return (yield start)


def drive(
    make: Callable[[], Coroutine[Start, Any, None]],
    *,
    alive: Callable[[], bool] = lambda: True,
    gate: Callable[[Callable[[], None]], None] = lambda call: call(),
) -> None:
    """Make the coroutine, and run it to its end.

    Once `alive` is False, it is not resumed any more, because its process was killed. `gate` calls a function
    immediately, or later if the process is frozen.
    """

    coroutine: Coroutine[Start, Any, None] | None = None

    def resume(value: object) -> None:
        gate(lambda: advance(value))

    def advance(value: object) -> None:
        nonlocal coroutine
        if not alive():
            if coroutine is not None:
                coroutine.close()
            return
        coroutine = coroutine or make()
        try:
            start = coroutine.send(value)
        except StopIteration:
            return
        start(_once(resume))

    resume(None)


def _once(resume: Resume) -> Resume:
    done = False

    def first(value: object) -> None:
        nonlocal done
        if not done:
            done = True
            resume(value)

    return first
