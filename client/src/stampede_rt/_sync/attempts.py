# Generated from ../_async by tools/generate.py; do not edit.
"""Runs an operation at the host of a channel or queue. If the binding is stale, runs it again at the new host."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Protocol, TypeVar

from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.directory_call import is_cut_short
from stampede_rt.errors import DeadlineExceeded, Overloaded, StampedeError
from stampede_rt.pacing.retry import OPEN_STREAMS_S, Backoff
from stampede_rt.transports.concurrency_sync import sleep

TRY_S_MIN = 0.1  # the least time of a try, also at the very end, so that a near host can answer

Result = TypeVar("Result")


class Locator(Protocol):
    """Finds the binding of a channel or queue."""

    def find(self, deadline_s: float) -> Binding:
        """Return the binding, from a cache or from the cluster.

        Blocks until `deadline_s` on the monotonic clock at most.
        """
        ...

    def is_stale(self, error: StampedeError) -> bool:
        """Whether `error` says that the cached channel or queue no longer exists. A new channel or queue may have the
        same name."""
        ...

    def forget(self, error: StampedeError | None = None) -> None:
        """Forget a binding that turned out to be stale. `error` may name the new host."""
        ...

    def check(self) -> None:
        """Raise Unavailable if the connection is closed, ForkedProcess after a fork, WrongEventLoop in another loop."""
        ...

    def explain(self, error: StampedeError) -> None:
        """Add the name of the channel or queue to `error`."""
        ...

    @property
    def closed(self) -> bool:
        """Whether the connection is closed. If it is, `attempt` does not try an operation again."""
        ...


def attempt(locator: Locator, operation: Callable[[Binding, float], Result], timeout_s: float) -> Result:
    """Run `operation` at the present host, and run it again after a retryable error and after DeadlineExceeded.

    Blocks for `timeout_s` seconds at most, or TRY_S_MIN longer if the last try begins at the end. `operation` gets the
    binding and the seconds that it may take. If the caller has too many open streams for its quota, `attempt` begins no
    try after OPEN_STREAMS_S: often only the caller itself can close a stream.
    Raises the error of the last try. If that try had too little time, and an earlier try has also failed, raises the
    error of the earlier try, because it says more. A try had too little time if it failed with DeadlineExceeded. In a
    call of less than a second, a supernode may also have found no majority, or not have learned the result of an
    update.
    """
    locator.check()
    deadline_s = time.monotonic() + timeout_s
    backoff = Backoff(deadline_s)
    followed = False  # whether a try was repeated without a delay, because the binding was stale
    failure: StampedeError | None = None  # the error to raise if no time is left for another try
    while True:
        began_s = time.monotonic()
        try:
            binding = locator.find(backoff.deadline_s)
            return operation(binding, max(deadline_s - time.monotonic(), TRY_S_MIN))
        except StampedeError as error:
            if locator.closed:
                locator.check()  # raises "closed" instead of the broken call's error
            locator.explain(error)
            slow = isinstance(error, DeadlineExceeded)  # the host may hang; the channel may get another host
            stale = not followed and locator.is_stale(error)
            if not (error.retryable or slow or stale):
                raise
            if isinstance(error, Overloaded) and error.is_over_open_streams:
                backoff.end_within(OPEN_STREAMS_S, time.monotonic())
            locator.forget(error)
            if stale or (error.reason == "MOVED" and not followed):
                followed = True
                continue
            cut_short = slow or is_cut_short(error, deadline_s - began_s)
            failure = failure if cut_short and failure is not None else error
            delay_s = backoff.next_delay_s(time.monotonic(), random.random())
            if delay_s is None:
                raise failure from (None if failure is error else error)
        sleep(delay_s)
