# Generated from ../_async by tools/generate.py; do not edit.
"""Producer pull: in each period the client calls a function of the program for an item (paper, section 4.1)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, Protocol

from stampede_rt._sync.listener import END_TIMEOUT_S, should_log
from stampede_rt._sync.session import Session
from stampede_rt.errors import ChannelNotFound, StampedeError
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.periods import Periods
from stampede_rt.transports.concurrency_sync import (
    BackgroundStart,
    BackgroundTask,
    Signal,
    call_back,
    check_callback,
    monotonic_nanos,
)

_log = logging.getLogger("stampede_rt")


class Clock(Protocol):
    """The clock that counts the periods."""

    def nanos(self) -> int:
        """Nanoseconds since a fixed moment. They never decrease."""
        ...

    def wait(self, stop: Signal, timeout_nanos: int) -> bool:
        """Wait until `stop` is set, for at most `timeout_nanos`. Returns whether it is set."""
        ...


class MonotonicClock:
    """The machine's monotonic clock."""

    def nanos(self) -> int:
        """Nanoseconds since a fixed moment. They never decrease."""
        return monotonic_nanos()

    def wait(self, stop: Signal, timeout_nanos: int) -> bool:
        """Wait until `stop` is set, for at most `timeout_nanos`. Returns whether it is set."""
        return stop.wait(timeout_nanos / 1e9)


class Sampler(BackgroundStart, BoundToProcess):
    """Calls a function once in each period and puts its result, until `cancel` (see `Channel.sample`).

    `samples` counts the items put; a result None is not put. `missed` counts periods that passed while the function or
    a put took too long. `failures` counts calls and puts that raised; `last_failure` is the last exception. The sampler
    continues after an exception, except in two cases: it ends when the channel is deleted (ChannelNotFound), and when
    the function raises SystemExit. `error` is then the reason; it is None while the sampler runs and after `cancel`.
    """

    def __init__(
        self,
        session: Session,
        name: str,
        put: Callable[[Any, float], Any],
        function: Callable[[], Any],
        every_nanos: int,
        clock: Clock,
    ) -> None:
        check_callback(function)
        self._session = session
        self._name = name
        self._put = put  # takes the value, and the number of seconds for which the put may wait for room
        self._function = function
        self._clock = clock
        self._periods = Periods(clock.nanos(), every_nanos)
        self._stop = Signal()
        self.active = True
        self.samples = self.failures = 0
        self.last_failure: Exception | None = None
        self.error: StampedeError | None = None
        session.attach(self)
        self._background = BackgroundTask(self._run, f"sample of {name}")

    @property
    def missed(self) -> int:
        """The number of periods that the sampler skipped, because the function or a put took too long."""
        return self._periods.missed

    def __repr__(self) -> str:
        state = self._session.state or ("" if self.active else "ended")
        return f"<Sampler of {self._name}{f', {state}' if state else ''}>"

    def cancel(self) -> None:
        """Begin no further call. A call under way continues; `join` waits for it.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._session.check_thread()
        self._stop.set()

    def join(self, timeout: float) -> bool:
        """Wait until the sampler has ended, for at most `timeout` seconds. Returns whether it has."""
        self._session.check_process()
        return self._background.join(timeout)

    def end(self) -> None:
        """Cancel, and wait a moment for a call under way. The connection calls this when it closes."""
        self.cancel()
        self.join(END_TIMEOUT_S)

    def _wait_for_start(self) -> None:
        return

    def _run(self) -> None:
        try:
            while not self._clock.wait(self._stop, self._periods.wait_nanos(self._clock.nanos())):
                self._periods.begin(self._clock.nanos())
                self._sample()
        except ChannelNotFound as error:
            self.error = error
            _log.error("sampling for %s has ended: %s", self._name, error)
        except SystemExit as end:  # the function raised it; Python prints nothing if SystemExit ends a thread
            self.error = StampedeError(f"its function raised {end!r}")
            _log.error("sampling for %s has ended: %s", self._name, self.error)
            raise
        finally:
            self.active = False
            self._session.detach(self)

    def _sample(self) -> None:
        try:
            value = call_back(self._function)
            if value is not None:
                self._put(value, self._periods.every_nanos / 1e9)
                self.samples += 1
        except ChannelNotFound:
            raise
        except Exception as error:  # noqa: BLE001  # counted and logged; the next period follows
            self.failures += 1
            self.last_failure = error
            if should_log(self.failures):
                _log.exception("sampling for %s continues after failure %d", self._name, self.failures)
