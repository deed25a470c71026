"""The blocked gets of one channel: each is looked at again when the channel changes and at instants of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.core.channel import Answer, Channel, Pending, WakeAt

Outcome = Answer | StampedeError
_TIMER_SECONDS_MIN = 0.0001  # the host's clock may run slower than the loop's: never spin


class WaitingGet:
    """One blocked get. `on_outcome` is called once, from the event loop, unless the get is cancelled before."""

    __slots__ = ("_deadline", "_on_outcome", "_timer", "_waiting", "pending")

    def __init__(self, pending: Pending, waiting: WaitingGets, on_outcome: Callable[[Outcome], None]) -> None:
        self.pending = pending
        self._waiting = waiting
        self._on_outcome = on_outcome
        self._timer: asyncio.TimerHandle | None = None
        self._deadline: asyncio.TimerHandle | None = None

    def arm(self, delay_s: float | None, poll: Callable[[WaitingGet], None]) -> None:
        """Look again after `delay_s`, and not at the instant named before; None: only when the channel changes."""
        if self._timer is not None:
            self._timer.cancel()
        loop = asyncio.get_running_loop()
        self._timer = None if delay_s is None else loop.call_later(max(delay_s, _TIMER_SECONDS_MIN), poll, self)

    def limit(self, wait_nanos: int, give_up: Callable[[WaitingGet], None]) -> None:
        """Give up after `wait_nanos`."""
        self._deadline = asyncio.get_running_loop().call_later(wait_nanos / 1e9, give_up, self)

    def cancel(self) -> None:
        """Forget the get; nothing of it is left behind. Idempotent."""
        for handle in (self._timer, self._deadline):
            if handle is not None:
                handle.cancel()
        self._waiting.remove(self)

    def finish(self, outcome: Outcome) -> None:
        """End the get with its outcome."""
        self.cancel()
        self._on_outcome(outcome)


class WaitingGets:
    """Of one channel, in the order of their coming, which is the order in which they are released."""

    def __init__(self, channel: Channel, now: Callable[[], int]) -> None:
        self._channel = channel
        self._now = now
        self._gets: dict[WaitingGet, None] = {}

    def __len__(self) -> int:
        return len(self._gets)

    def add(
        self, pending: Pending, wake: WakeAt, wait_nanos: int, now: int, on_outcome: Callable[[Outcome], None]
    ) -> WaitingGet:
        """Block a get that has just been polled. `wait_nanos` below 0: as long as it is not cancelled."""
        get = WaitingGet(pending, self, on_outcome)
        self._gets[get] = None
        self._arm(get, wake, now)
        if wait_nanos >= 0:
            get.limit(wait_nanos, self._give_up)
        return get

    def remove(self, get: WaitingGet) -> None:
        """It does not wait any more."""
        self._gets.pop(get, None)

    def changed(self, now: int) -> None:
        """The channel has a new item, an advance or another policy: look at all of them, first come first."""
        for get in list(self._gets):
            if get in self._gets:  # an outcome may have cancelled others
                self._look(get, now)

    def end_all(self, error: StampedeError) -> None:
        """The channel is not served any more."""
        for get in list(self._gets):
            get.finish(error)

    def _look(self, get: WaitingGet, now: int) -> None:
        found = self._channel.poll(get.pending, now)
        if isinstance(found, WakeAt):
            self._arm(get, found, now)
        else:
            get.finish(found)

    def _arm(self, get: WaitingGet, wake: WakeAt, now: int) -> None:
        get.arm(None if wake.instant is None else (wake.instant - now) / 1e9, self._look_now)

    def _look_now(self, get: WaitingGet) -> None:
        self._look(get, self._now())

    def _give_up(self, get: WaitingGet) -> None:
        get.finish(self._channel.give_up(get.pending, self._now()))
