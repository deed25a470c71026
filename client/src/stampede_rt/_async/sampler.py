"""Producer pull: a function that is asked for an item periodically (paper, section 4.1)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, Protocol

from stampede_rt._async.listener import END_TIMEOUT_S, should_log
from stampede_rt._async.session import Session
from stampede_rt.errors import ChannelNotFound, StampedeError
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.periods import Periods
from stampede_rt.transports.concurrency_async import (
    BackgroundStart,
    BackgroundTask,
    Signal,
    call_back,
    check_callback,
    monotonic_nanos,
)

_log = logging.getLogger("stampede_rt")


class Clock(Protocol):
    """The time that periods are counted in."""

    def nanos(self) -> int:
        """A reading that only grows."""
        ...

    async def wait(self, stop: Signal, timeout_nanos: int) -> bool:
        """Block until `stop`, `timeout_nanos` at most; whether it was set."""
        ...


class MonotonicClock:
    """The machine's."""

    def nanos(self) -> int:
        """A reading that only grows."""
        return monotonic_nanos()

    async def wait(self, stop: Signal, timeout_nanos: int) -> bool:
        """Block until `stop`, `timeout_nanos` at most; whether it was set."""
        return await stop.wait(timeout_nanos / 1e9)


class Sampler(BackgroundStart, BoundToProcess):
    """What asks a function for an item every so often (see `Channel.sample`), until `cancel`.

    `samples` counts items put, `missed` periods that passed while the function or a put took too long. `failures`
    counts calls and puts that raised, `last_failure` is what the last of them raised; it goes on after them. `error`
    is what ended it: ChannelNotFound once the channel is deleted; None while it runs and after `cancel`.
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
        self._put = put  # takes the value and how many seconds it may wait on a full channel
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
        """Periods that passed without a sample."""
        return self._periods.missed

    def __repr__(self) -> str:
        state = self._session.state or ("" if self.active else "ended")
        return f"<Sampler of {self._name}{f', {state}' if state else ''}>"

    def cancel(self) -> None:
        """Begin no further call. One that is under way goes on; `join` waits for it. Callable from any thread."""
        self._stop.set()

    async def join(self, timeout: float) -> bool:
        """Block until it has ended, `timeout` seconds at most; whether it has."""
        self._session.check_process()
        return await self._background.join(timeout)

    async def end(self) -> None:
        """What closing the connection does."""
        self.cancel()
        await self.join(END_TIMEOUT_S)

    async def _begun(self) -> None:
        return

    async def _run(self) -> None:
        try:
            while not await self._clock.wait(self._stop, self._periods.wait_nanos(self._clock.nanos())):
                self._periods.begin(self._clock.nanos())
                await self._sample()
        except ChannelNotFound as error:
            self.error = error
            _log.error("sampling for %s has ended: %s", self._name, error)
        finally:
            self.active = False
            self._session.detach(self)

    async def _sample(self) -> None:
        try:
            value = await call_back(self._function)
            if value is not None:
                await self._put(value, self._periods.every_nanos / 1e9)
                self.samples += 1
        except ChannelNotFound:
            raise
        except Exception as error:  # noqa: BLE001  # whatever it is, it is told, and the next one comes
            self.failures += 1
            self.last_failure = error
            if should_log(self.failures):
                _log.exception("sampling for %s: failure %d; it goes on", self._name, self.failures)
