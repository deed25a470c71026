"""The blocked gets of one channel: each is looked at again when the channel changes and at instants of its own.

Ten thousand of them cost about 2 KiB each. After a change only those are looked at that it may release: they wait in
the order of what they need, and are found by how far the change reaches. Those that are released are so in the order of
their arrival.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from operator import attrgetter
from typing import Protocol

from sortedcontainers import SortedKeyList

from stampede_rt.errors import Overloaded, StampedeError
from stampede_rt_channel_host.core.channel import (
    AFTER_ALL,
    BEFORE_ALL,
    Coming,
    Needs,
    Pending,
    Pieces,
    ReadAnswer,
    Unfinished,
    WakeAt,
    first_of,
)

Outcome = ReadAnswer | Unfinished[ReadAnswer | WakeAt] | Unfinished[ReadAnswer] | StampedeError
"""A long answer is begun where the get is released, and finished by whoever hears of it."""

WAITING_GETS_MAX = 20_000
GETS_PER_PIECE = 64
_TIMER_SECONDS_MIN = 0.0001  # the host's clock may run slower than the loop's: never spin
_TIMER_SECONDS_MAX = 10.0  # or faster: an instant that is far ahead may come sooner than it seems


class WaitingGet:
    """One blocked get. `on_outcome` is called once, from the event loop, unless the get is cancelled before.

    `arrival` and `needs` are its place among the others.
    """

    __slots__ = ("_deadline", "_instant", "_on_outcome", "_timer", "_waiting", "arrival", "needs", "pending")

    def __init__(
        self, pending: Pending, waiting: WaitingGets, arrival: int, on_outcome: Callable[[Outcome], None]
    ) -> None:
        self.pending = pending
        self.arrival = arrival
        self.needs = Needs()
        self._waiting = waiting
        self._on_outcome = on_outcome
        self._instant: int | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._deadline: asyncio.TimerHandle | None = None

    def arm(self, instant: int | None, now: int, look: Callable[[WaitingGet], None]) -> None:
        """Look again at `instant`, and not at the one named before; None: only when the channel changes."""
        if self._timer is not None and instant == self._instant:
            return
        self._disarm()
        self._instant = instant
        if instant is not None:
            delay_s = min(max((instant - now) / 1e9, _TIMER_SECONDS_MIN), _TIMER_SECONDS_MAX)
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._fire, look)

    def limit(self, wait_nanos: int, give_up: Callable[[WaitingGet], None]) -> None:
        """Give up after `wait_nanos`."""
        self._deadline = asyncio.get_running_loop().call_later(wait_nanos / 1e9, give_up, self)

    def cancel(self) -> None:
        """Forget the get; nothing of it is left behind. Idempotent."""
        self._disarm()
        if self._deadline is not None:
            self._deadline.cancel()
        self._waiting.remove(self)

    def finish(self, outcome: Outcome) -> None:
        """End the get with its outcome."""
        self.cancel()
        self._on_outcome(outcome)

    def _fire(self, look: Callable[[WaitingGet], None]) -> None:
        self._timer = None
        look(self)

    def _disarm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class Source(Protocol):
    """What gets wait for: a channel, or what a group shows of it."""

    def polling(self, pending: Pending, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """As `ChannelCore.polling`."""

    def giving_up(self, pending: Pending, now: int) -> Pieces[ReadAnswer]:
        """As `ChannelCore.giving_up`."""


class WaitingGets:
    """Of one channel, WAITING_GETS_MAX at the most. Released in the order of their arrival.

    `coming` follows the channel; `cut` gives up to where it is visible. `looked_at` counts looks.
    """

    def __init__(
        self, source: Source, coming: Coming, now: Callable[[], int], cut: Callable[[], int] = lambda: AFTER_ALL
    ) -> None:
        self.looked_at = 0
        self._source = source
        self._coming = coming
        self._now = now
        self._cut = cut
        self._arrivals = 0
        self._waiting: dict[WaitingGet, None] = {}
        self._by_need = [SortedKeyList(key=_Key(place)) for place in range(len(Needs._fields))]

    def __len__(self) -> int:
        return len(self._waiting)

    def add(
        self, pending: Pending, wake: WakeAt, wait_nanos: int, now: int, on_outcome: Callable[[Outcome], None]
    ) -> WaitingGet:
        """Block a get that has just been polled. `wait_nanos` below 0: as long as it is not cancelled.

        Raises Overloaded if as many as there may be are blocked already.
        """
        if len(self) >= WAITING_GETS_MAX:
            raise Overloaded(
                f"{WAITING_GETS_MAX} gets wait at the channel already, which is the most; subscribe, or get later"
            )
        if not self._waiting:
            self._coming.begin(self._cut())
        self._arrivals += 1
        get = WaitingGet(pending, self, self._arrivals, on_outcome)
        self._put_aside(get, wake, now)
        if wait_nanos >= 0:
            get.limit(wait_nanos, self._give_up)
        return get

    def remove(self, get: WaitingGet) -> None:
        """It does not wait any more."""
        if get in self._waiting:
            del self._waiting[get]
            self._leave(get)

    def changed(self, now: int) -> None:
        """The channel has a new item, an advance or another policy, or more of it is visible: look at those whom that
        may release, in order."""
        found: dict[WaitingGet, None] = {}
        for ordered, reached in zip(self._by_need, self._coming.reach(now, self._cut()), strict=True):
            if reached is not None:
                found |= dict.fromkeys(ordered.irange_key(max_key=(reached, self._arrivals)))
        for get in sorted(found, key=attrgetter("arrival")):
            if get in self._waiting:  # an outcome may have cancelled others
                self._look(get, now)

    def ending(self, error: StampedeError) -> Pieces[None]:
        """Those that wait now hear, in pieces, that the channel is not served any more."""
        for at, get in enumerate(list(self._waiting), 1):
            if get in self._waiting:  # else it was released since the piece before
                get.finish(error)
            if at % GETS_PER_PIECE == 0:
                yield

    def _look(self, get: WaitingGet, now: int) -> None:
        self.looked_at += 1
        found = first_of(self._source.polling(get.pending, now))
        if isinstance(found, WakeAt):
            self._put_aside(get, found, now)
        else:
            get.finish(found)

    def _put_aside(self, get: WaitingGet, wake: WakeAt, now: int) -> None:
        needs = wake.needs or Needs(BEFORE_ALL)
        if get not in self._waiting or needs != get.needs:
            self._leave(get)
            get.needs = needs
            self._waiting[get] = None
            for ordered, need in zip(self._by_need, needs, strict=True):
                if need is not None:
                    ordered.add(get)
        get.arm(wake.instant, now, self._look_now)

    def _leave(self, get: WaitingGet) -> None:
        for ordered, need in zip(self._by_need, get.needs, strict=True):
            if need is not None:
                ordered.remove(get)
        get.needs = Needs()

    def _look_now(self, get: WaitingGet) -> None:
        self._look(get, self._now())

    def _give_up(self, get: WaitingGet) -> None:
        found: ReadAnswer | Unfinished[ReadAnswer] = first_of(self._source.giving_up(get.pending, self._now()))
        get.finish(found)


class _Key:
    """The order by one of the needs, and by arrival."""

    __slots__ = ("_place",)

    def __init__(self, place: int) -> None:
        self._place = place

    def __call__(self, get: WaitingGet) -> tuple[int, int]:
        need = get.needs[self._place]
        assert need is not None, "it is in no order that it has no place in"
        return need, get.arrival
