"""Tries an operation at the place of a channel or queue, and again at its new place if that one is stale or gone."""

from __future__ import annotations

import random
import time
from collections.abc import Awaitable, Callable
from typing import Protocol, TypeVar

from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import DeadlineExceeded, StampedeError
from stampede_rt.pacing.retry import Backoff
from stampede_rt.transports.concurrency_async import sleep

Result = TypeVar("Result")


class Locator(Protocol):
    """Where a channel or queue is, as far as it is known; what turns out to be stale counts as a miss."""

    async def find(self, deadline_s: float) -> Binding:
        """The place, from a cache or by asking, until `deadline_s` on the monotonic clock."""
        ...

    def forget(self) -> None:
        """The place turned out to be stale."""
        ...

    def check(self) -> None:
        """Raises what keeps the connection from being used: it is closed, or was made before a fork."""
        ...

    def explain(self, error: StampedeError) -> None:
        """Name the thing in `error`."""
        ...

    @property
    def closed(self) -> bool:
        """The connection is closed: nothing is tried again."""
        ...


async def attempt(
    locator: Locator, operation: Callable[[Binding], Awaitable[Result]], timeout_s: float | None
) -> Result:
    """Run `operation` where the thing is, again and again while what it raises is retryable.

    `timeout_s` bounds the trying, not a wait inside `operation`; None: for ever. Raises what the last try met; if only
    the end of the time cut that one short, what the try before met, which says more.
    """
    locator.check()
    backoff = Backoff(float("inf") if timeout_s is None else time.monotonic() + timeout_s)
    told: StampedeError | None = None
    while True:
        try:
            return await operation(await locator.find(backoff.deadline_s))
        except StampedeError as error:
            if locator.closed:
                locator.check()  # says so, instead of what the call met when its connection went
            locator.explain(error)
            slow = isinstance(error, DeadlineExceeded)  # a host that hangs may be lost soon
            if not (error.retryable or slow):
                raise
            locator.forget()
            told = told if slow and told is not None else error
            delay_s = backoff.next_delay_s(time.monotonic(), random.random())
            if delay_s is None:
                raise told from (None if told is error else error)
        await sleep(delay_s)
