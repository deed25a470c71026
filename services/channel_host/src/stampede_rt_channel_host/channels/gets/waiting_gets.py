"""The blocked gets of one channel. The host looks at a get again after a change that may release it, and at the instant
at which the clock may release it.

A blocked get takes about 2 KiB of memory. The host sorts the gets by the change that they need. So after a change it
looks only at the gets that this change may release. If these gets are many, the host looks at them in pieces,
in the channel's state right after the change. So no get misses the change that releases it (decision 0085).
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from stampede_rt.errors import Overloaded, StampedeError
from stampede_rt_channel_host.channels.gets.get_release import GetRelease, PolledSource, Source
from stampede_rt_channel_host.channels.gets.waiting_get import (
    NEED_KEYS,
    Outcome,
    WaitingGet,
    instant_key,
    with_interval,
)
from stampede_rt_channel_host.channels.time_limits import TimeLimits
from stampede_rt_channel_host.core.channel import (
    AFTER_ALL,
    BEFORE_ALL,
    Needs,
    PendingGet,
    Pieces,
    ReachTracker,
    ReadAnswer,
    UnfinishedWork,
    WakeAt,
    first_of,
    run_to_end,
)
from stampede_rt_channel_host.core.keyed_list import KeyedList

WAITING_GETS_MAX = 20_000
GETS_PER_PIECE = 32
SLICES_PER_LOOK = 8
"""It takes about as long to find an answer of this many slices as to look at one more get."""
RELEASES_MAX = 64
"""The most changes whose states the host keeps while it looks at gets.

A further change is joined to the last kept one, which then has the state after the further change.
"""
_TIMER_SECONDS_MIN = 0.0001  # the host's clock may be slower than the loop's: the timer must not fire again and again
# the host's clock may also be faster: a far instant may come sooner than the loop's clock says
_TIMER_SECONDS_MAX = 10.0


class WaitingGets:
    """The blocked gets of one channel, at most WAITING_GETS_MAX. One step releases gets in the order of arrival.

    `tracker` computes which needs of gets a change may fulfil. `cut` gives the instant before which the items of the
    channel are visible. `looked_at` counts the looks at gets.
    """

    def __init__(
        self,
        source: Source,
        tracker: ReachTracker,
        now: Callable[[], int],
        cut: Callable[[], int] = lambda: AFTER_ALL,
        begin: Callable[[Pieces[None]], None] = run_to_end,
        limits: TimeLimits | None = None,
    ) -> None:
        """`begin` does long work for which no caller waits (`PieceScheduler.begin`).

        `limits` bounds the waits of all gets of the host; None: these gets have a `TimeLimits` of their own.
        """
        self.looked_at = 0
        self._source = source
        self._tracker = tracker
        self._now = now
        self._cut = cut
        self._begin = begin
        self._limits = TimeLimits(begin) if limits is None else limits
        self._arrivals = 0
        self._waiting: dict[WaitingGet, None] = {}
        self._by_need: list[KeyedList[WaitingGet]] = [KeyedList(key) for key in NEED_KEYS]
        self._by_instant: KeyedList[WaitingGet] = KeyedList(instant_key)
        self._timer: asyncio.TimerHandle | None = None
        self._timer_instant = 0
        self._releases: list[GetRelease] = []
        self._working = False  # whether `_pieces` is under way

    def __len__(self) -> int:
        return len(self._waiting)

    def add(
        self, pending: PendingGet, wake: WakeAt, wait_nanos: int, now: int, on_outcome: Callable[[Outcome], None]
    ) -> WaitingGet:
        """Block a get that was just polled. `wake`: the result of that poll. `wait_nanos` below 0: without limit.

        Raises Overloaded if WAITING_GETS_MAX gets are blocked already.
        """
        if len(self) >= WAITING_GETS_MAX:
            raise Overloaded(f"{WAITING_GETS_MAX} gets wait at the channel already, the limit; subscribe, or get later")
        if not self._waiting:
            self._tracker.begin(self._cut())
        self._arrivals += 1
        get = WaitingGet(pending, self._arrivals, on_outcome, self.remove)
        self._insert(get, wake)
        self._set_timer()
        if wait_nanos >= 0:
            get.limit(wait_nanos, self._limits, self._give_up)
        return get

    def remove(self, get: WaitingGet) -> None:
        """Remove a get that no longer waits."""
        if get in self._waiting:
            del self._waiting[get]
            self._leave(get)
            self._note_instant(get, None)
            if not len(self._by_instant):
                self._set_timer()

    def changed(self, now: int) -> None:
        """Look at the gets that a change may release: a new item, an advance, another policy, or a later cut.

        Looks at all of them now, or, if they are many, in pieces, in the channel's present state.
        """
        release = GetRelease(self._tracker.reach(now, self._cut()), self._arrivals)
        found = deque(release.take(self._by_need, GETS_PER_PIECE + 1))
        if not self._releases and len(found) <= GETS_PER_PIECE:
            self._look_at(found, self._source, now)
            self._set_timer()
        if found:
            self._keep(GetRelease(release.reach, release.arrivals), now)
            self._work()

    def ending(self, error: StampedeError) -> Pieces[None]:
        """End the gets that wait now with `error`, in pieces, because the host no longer serves the channel."""
        self._drop_releases()
        gets = deque(self._waiting)  # emptied step by step, because to free very many gets in one step takes long
        while gets:
            for _ in range(min(GETS_PER_PIECE, len(gets))):
                get = gets.popleft()
                if get in self._waiting:  # it may have been released since the last piece
                    get.finish(with_interval(error, get.pending))
            if gets:
                yield

    def _keep(self, release: GetRelease, now: int) -> None:
        """Keep a change and the state after it, until `_pieces` has looked at the gets that the change may release."""
        if len(self._releases) >= RELEASES_MAX:
            self._releases[-1].close()
            self._releases[-1].merge(release)
        else:
            self._releases.append(release)
        self._releases[-1].snapshot = self._source.snapshot(now)

    def _work(self) -> None:
        if not self._working:
            self._working = True
            self._begin(self._pieces())

    def _pieces(self) -> Pieces[None]:
        """Look at the gets that changes may release, change by change, and then at the gets whose instant has come."""
        try:
            while self._look_at_some():
                yield
        finally:
            self._working = False
            self._drop_releases()
            self._set_timer()

    def _look_at_some(self) -> bool:
        """Look at the next few gets. Returns True if others are left."""
        now = self._now()
        if self._releases:
            release = self._releases[0]
            found = release.taken = release.taken or deque(release.take(self._by_need, GETS_PER_PIECE))
            assert release.snapshot is not None, "each release was stored with its state"
            is_over = not found
            self._look_at(found, release.snapshot, now)
            if is_over and self._releases and self._releases[0] is release:
                self._releases.pop(0).close()
        else:
            due = self._by_instant.after(None, (now, self._arrivals), GETS_PER_PIECE)
            self._look_at(deque(due), self._source, now)
        return bool(self._releases) or self._first_instant() <= self._now()

    def _drop_releases(self) -> None:
        while self._releases:
            self._releases.pop(0).close()

    def _look_at(self, gets: deque[WaitingGet], where: PolledSource, now: int) -> None:
        """Look at the next gets until the work of one piece is done. The other gets stay in `gets`."""
        left = GETS_PER_PIECE
        while gets and left > 0:
            get = gets.popleft()
            if get in self._waiting:  # an outcome may have cancelled other gets
                left -= self._look(get, where, now)

    def _look(self, get: WaitingGet, where: PolledSource, now: int) -> int:
        """Poll a get. Returns the cost of the poll. A poll that leaves the get blocked costs 1."""
        self.looked_at += 1
        found = first_of(where.polling(get.pending, now))
        if isinstance(found, WakeAt):
            self._insert(get, found)
            return 1
        get.finish(found)
        return GETS_PER_PIECE if isinstance(found, UnfinishedWork) else 1 + len(found.slices) // SLICES_PER_LOOK

    def _insert(self, get: WaitingGet, wake: WakeAt) -> None:
        """Let a get wait, sorted by the needs and the instant that its last poll returned."""
        needs = wake.needs or Needs(BEFORE_ALL)
        if get not in self._waiting or needs != get.needs:
            self._leave(get)
            get.needs = needs
            self._waiting[get] = None
            for ordered, need in zip(self._by_need, needs, strict=True):
                if need is not None:
                    ordered.add(get)
        self._note_instant(get, wake.instant)

    def _leave(self, get: WaitingGet) -> None:
        """Take a get out of the orders by needs."""
        for ordered, need in zip(self._by_need, get.needs, strict=True):
            if need is not None:
                ordered.remove(get)
        get.needs = Needs()

    def _note_instant(self, get: WaitingGet, instant: int | None) -> None:
        if get.instant == instant:
            return
        if get.instant is not None:
            self._by_instant.remove(get)
        get.instant = instant
        if instant is not None:
            self._by_instant.add(get)

    def _first_instant(self) -> int:
        """The earliest instant at which the clock may release a get; AFTER_ALL: there is no such instant."""
        return instant_key(self._by_instant[0])[0] if len(self._by_instant) else AFTER_ALL

    def _set_timer(self) -> None:
        """Set the timer for the first instant. A timer that fires early does no harm."""
        first = self._first_instant()
        if self._timer is not None and not self._timer_instant <= first < AFTER_ALL:
            self._timer.cancel()
            self._timer = None
        if self._timer is None and first < AFTER_ALL and not self._working:
            self._timer_instant = first
            delay_s = min(max((self._timer_instant - self._now()) / 1e9, _TIMER_SECONDS_MIN), _TIMER_SECONDS_MAX)
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._fire)

    def _fire(self) -> None:
        self._timer = None
        self._work()

    def _give_up(self, get: WaitingGet) -> None:
        """End the wait of a get. Look at the kept changes first. If none releases the get, give the present answer."""
        for release in list(self._releases):
            if release.snapshot is not None and get.arrival <= release.arrivals and get in self._waiting:
                self._look(get, release.snapshot, self._now())
        if get in self._waiting:
            found: ReadAnswer | UnfinishedWork[ReadAnswer] = first_of(self._source.giving_up(get.pending, self._now()))
            get.finish(found)
