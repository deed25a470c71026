# Generated from ../_async by tools/generate.py; do not edit.
"""Consumer push: the client calls a function of the program for each item (paper, section 4.1)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from stampede_rt._sync.session import Session
from stampede_rt._sync.subscription import Subscription
from stampede_rt.errors import IncarnationLost, StampedeError
from stampede_rt.handles import BoundToProcess
from stampede_rt.transports.concurrency_sync import BackgroundStart, BackgroundTask, Signal, call_back, check_callback
from stampede_rt.values.statistics import MulticastStats

END_TIMEOUT_S = 1.0  # the longest wait for a call under way when the connection closes
_log = logging.getLogger("stampede_rt")


def should_log(count: int) -> bool:
    """Whether to log the `count`-th failure: the 1st, 2nd, 4th, 8th and so on, so that a log stays readable."""
    return count & (count - 1) == 0


class Listener(BackgroundStart, BoundToProcess):
    """Calls a function for each item, one call after the other, until `cancel` (see `Channel.on_item`).

    `delivered` counts the calls that returned. `failures` counts the calls that raised; `last_failure` is the last
    exception. The listener continues after an exception. `losses` counts how many times the channel's host was lost
    with its items. After such a loss the listener continues with the new incarnation. `error` is the error that ended
    the listener, or None while the listener runs and after `cancel`. With asyncio, awaiting the listener waits until
    the subscription is open, and raises `error` if there is one.
    """

    def __init__(
        self, session: Session, name: str, subscribe: Callable[[bool], Subscription], function: Callable[[Any], Any]
    ) -> None:
        check_callback(function)
        self._session = session
        self._name = name
        self._subscribe = subscribe  # True: subscribe to the new incarnation, from its oldest item on
        self._function = function
        self._subscription = subscribe(False)
        self._dropped_before = self._skipped_before = self._reconnects_before = 0  # sums of earlier subscriptions
        self._holds = Signal()  # is set when the subscription is open, or when the listener has ended
        self._cancelled = False
        self.active = True
        self.delivered = self.failures = self._incarnations_lost = self._losses_before = 0
        self.last_failure: Exception | None = None
        self.error: StampedeError | None = None
        session.attach(self)
        self._background = BackgroundTask(self._run, f"on_item of {name}")

    @property
    def losses(self) -> int:
        """The number of times that the channel lost its host and items."""
        return self._incarnations_lost + self._losses_before + self._subscription.losses

    @property
    def dropped(self) -> int:
        """The number of items that retention collected before the client fetched them for the function."""
        return self._dropped_before + self._subscription.dropped

    @property
    def skipped(self) -> int:
        """The number of items that mode "newest" left out, because a newer item came before the function was ready."""
        return self._skipped_before + self._subscription.skipped

    @property
    def reconnects(self) -> int:
        """The number of times that the client has opened the subscription again after a break."""
        return self._reconnects_before + self._subscription.reconnects

    @property
    def multicast(self) -> MulticastStats | None:
        """The counts of datagrams of the present subscription; None if it does not use `via="multicast"`."""
        return self._subscription.multicast

    @property
    def connected(self) -> bool:
        """Whether the subscription is open, as last known. False while the client opens it again, and after the end."""
        return self.active and self._subscription.connected

    def __repr__(self) -> str:
        state = self._session.state or ("" if self.active else "ended")
        return f"<Listener of {self._name}{f', {state}' if state else ''}>"

    def cancel(self) -> None:
        """Begin no further call. A call under way continues; `join` waits for it.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._session.check_thread()
        self._cancelled = True
        self._subscription.close()

    def join(self, timeout: float) -> bool:
        """Wait until the listener has ended, for at most `timeout` seconds. Returns whether the listener has ended."""
        self._session.check_process()
        return self._background.join(timeout)

    def end(self) -> None:
        """Cancel, and wait a moment for a call under way. The connection calls this when it closes."""
        self.cancel()
        self.join(END_TIMEOUT_S)

    def _wait_for_start(self) -> None:
        self._holds.wait(None)
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        try:
            while not self._cancelled and self._listen():
                pass
        except StampedeError as error:
            self._fail(error)
        except Exception as defect:  # noqa: BLE001  # otherwise nobody would learn of the defect
            failure = StampedeError(f"on_item of {self._name} failed with a defect: {type(defect).__name__}: {defect}")
            failure.__cause__ = defect
            self._fail(failure)
        except SystemExit as end:  # the function raised it; Python prints nothing if SystemExit ends a thread
            self._fail(StampedeError(f"its function raised {end!r}"))
            raise
        finally:
            self.active = False
            self._holds.set()
            self._session.detach(self)

    def _fail(self, error: StampedeError) -> None:
        if not (self._cancelled or self._session.closed):
            self.error = error
            _log.error("on_item of %s has ended: %s", self._name, error, exc_info=error.__cause__)

    def _listen(self) -> bool:
        """Call the function for the items of one subscription. Returns whether to continue with a new incarnation."""
        try:
            with self._subscription as items:
                self._holds.set()
                for item in items:
                    self._call(item)
            return False  # the program has cancelled, or a replay has ended
        except IncarnationLost as error:
            self._incarnations_lost += 1
            _log.warning("on_item of %s continues with a new incarnation: %s", self._name, error)
            self._dropped_before, self._skipped_before = self.dropped, self.skipped
            self._losses_before += self._subscription.losses
            self._reconnects_before = self.reconnects
            self._subscription = self._subscribe(True)
            if self._cancelled:  # `cancel` closed only the former subscription
                self._subscription.close()
            return True

    def _call(self, item: Any) -> None:
        try:
            call_back(self._function, item)
            self.delivered += 1
        except Exception as error:  # noqa: BLE001  # counted and logged; the next item follows
            self.failures += 1
            self.last_failure = error
            if should_log(self.failures):
                _log.exception("on_item of %s continues after failure %d of its function", self._name, self.failures)
