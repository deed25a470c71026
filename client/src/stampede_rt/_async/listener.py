"""Push: a function that is called for each item (paper, section 4.1)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from stampede_rt._async.session import Session
from stampede_rt._async.subscription import Subscription
from stampede_rt.errors import IncarnationLost, StampedeError
from stampede_rt.handles import BoundToProcess
from stampede_rt.transports.concurrency_async import BackgroundStart, BackgroundTask, Signal, call_back, check_callback

END_TIMEOUT_S = 1.0
_log = logging.getLogger("stampede_rt")


def should_log(count: int) -> bool:
    """Whether the `count`-th failure is logged: the 1st, 2nd, 4th, 8th and so on, so that a log stays readable."""
    return count & (count - 1) == 0


class Listener(BackgroundStart, BoundToProcess):
    """What calls a function for each item (see `Channel.on_item`), one after the other, until `cancel`.

    `delivered` counts finished calls, `failures` those that raised, `last_failure` is what the last of them raised;
    it goes on after them. `skipped` and `dropped` are those of the subscription. `losses` counts how often the
    channel's host was lost with what it held: then it goes on with everything that the new incarnation gets.
    `reconnects` counts how often it came back after its connection broke, `connected` says whether it is open. `error`
    is what ended it, None while it runs and after `cancel`. On asyncio, awaiting it waits until it has begun.
    """

    def __init__(
        self, session: Session, name: str, subscribe: Callable[[bool], Subscription], function: Callable[[Any], Any]
    ) -> None:
        check_callback(function)
        self._session = session
        self._name = name
        self._subscribe = subscribe  # True: everything that the channel's new incarnation holds
        self._function = function
        self._subscription = subscribe(False)
        self._dropped_before = self._skipped_before = self._reconnects_before = 0  # of subscriptions that ended
        self._holds = Signal()
        self._cancelled = False
        self.active = True
        self.delivered = self.failures = self.losses = 0
        self.last_failure: Exception | None = None
        self.error: StampedeError | None = None
        session.attach(self)
        self._background = BackgroundTask(self._run, f"on_item of {name}")

    @property
    def dropped(self) -> int:
        """Items that retention collected before the function had time for them."""
        return self._dropped_before + self._subscription.dropped

    @property
    def skipped(self) -> int:
        """Items that mode "newest" passed over."""
        return self._skipped_before + self._subscription.skipped

    @property
    def reconnects(self) -> int:
        """How often it came back after its connection broke."""
        return self._reconnects_before + self._subscription.reconnects

    @property
    def connected(self) -> bool:
        """It is open, as far as is known; if not, it is being opened again, or has ended."""
        return self.active and self._subscription.connected

    def __repr__(self) -> str:
        state = self._session.state or ("" if self.active else "ended")
        return f"<Listener of {self._name}{f', {state}' if state else ''}>"

    def cancel(self) -> None:
        """Begin no further call. One that is under way goes on; `join` waits for it. Callable from anywhere."""
        self._cancelled = True
        self._subscription.close()

    async def join(self, timeout: float) -> bool:
        """Block until it has ended, `timeout` seconds at most; whether it has."""
        self._session.check_process()
        return await self._background.join(timeout)

    async def end(self) -> None:
        """What closing the connection does."""
        self.cancel()
        await self.join(END_TIMEOUT_S)

    async def _begun(self) -> None:
        await self._holds.wait(None)
        if self.error is not None:
            raise self.error

    async def _run(self) -> None:
        try:
            while not self._cancelled:
                await self._listen()
        except StampedeError as error:
            self._fail(error)
        except Exception as defect:  # noqa: BLE001  # a thread's end is heard by nobody else
            failure = StampedeError(f"on_item of {self._name} met a defect: {type(defect).__name__}: {defect}")
            failure.__cause__ = defect
            self._fail(failure)
        finally:
            self.active = False
            self._holds.set()
            self._session.detach(self)

    def _fail(self, error: StampedeError) -> None:
        if not (self._cancelled or self._session.closed):
            self.error = error
            _log.error("on_item of %s has ended: %s", self._name, error, exc_info=error.__cause__)

    async def _listen(self) -> None:
        try:
            async with self._subscription as items:
                self._holds.set()
                async for item in items:
                    await self._call(item)
        except IncarnationLost as error:
            self.losses += 1
            _log.warning("on_item of %s goes on with a new incarnation: %s", self._name, error)
            self._dropped_before, self._skipped_before = self.dropped, self.skipped
            self._reconnects_before = self.reconnects
            self._subscription = self._subscribe(True)
            if self._cancelled:  # while it was being made
                self._subscription.close()

    async def _call(self, item: Any) -> None:
        try:
            await call_back(self._function, item)
            self.delivered += 1
        except Exception as error:  # noqa: BLE001  # whatever it is, it is told, and the next one comes
            self.failures += 1
            self.last_failure = error
            if should_log(self.failures):
                _log.exception("on_item of %s: failure %d; it goes on", self._name, self.failures)
