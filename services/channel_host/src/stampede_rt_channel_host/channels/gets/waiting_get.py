"""One blocked get, and the keys by which the host sorts blocked gets."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from stampede_rt.errors import StampedeError, error_for
from stampede_rt_channel_host.channels.time_limits import TimeLimit, TimeLimits
from stampede_rt_channel_host.core.channel import (
    Needs,
    PendingGet,
    ReadAnswer,
    UnfinishedWork,
    WakeAt,
)
from stampede_rt_channel_host.core.keyed_list import Key

Outcome = ReadAnswer | UnfinishedWork[ReadAnswer | WakeAt] | UnfinishedWork[ReadAnswer] | StampedeError
"""`UnfinishedWork`: the host has made the first piece of a long answer. Its receiver performs the rest."""


class WaitingGet:
    """One blocked get. `on_outcome` is called once, from the event loop, unless the get is cancelled before.

    The gets are sorted by `arrival` and `needs`. `instant` is the time at which the clock may release the get.
    """

    __slots__ = ("_limit", "_limits", "_on_outcome", "_remove", "arrival", "instant", "needs", "pending")

    def __init__(
        self,
        pending: PendingGet,
        arrival: int,
        on_outcome: Callable[[Outcome], None],
        remove: Callable[[WaitingGet], None],
    ) -> None:
        """`remove` removes this get from the blocked gets of its channel."""
        self.pending = pending
        self.arrival = arrival
        self.needs = Needs()
        self.instant: int | None = None
        self._remove = remove
        self._on_outcome = on_outcome
        self._limits: TimeLimits | None = None
        self._limit: TimeLimit | None = None

    def limit(self, wait_nanos: int, limits: TimeLimits, give_up: Callable[[WaitingGet], None]) -> None:
        """Call `give_up` with this get after `wait_nanos` nanoseconds, unless the get ends before."""
        self._limits, self._limit = limits, limits.add(wait_nanos, partial(give_up, self))

    def cancel(self) -> None:
        """Stop the wait and its time limit, without an outcome. Idempotent."""
        if self._limits is not None and self._limit is not None:
            self._limits.remove(self._limit)
            self._limit = None
        self._remove(self)

    def finish(self, outcome: Outcome) -> None:
        """End the get with its outcome."""
        self.cancel()
        self._on_outcome(outcome)


def with_interval(error: StampedeError, pending: PendingGet) -> StampedeError:
    """The error for a get that waits. If the channel has moved, the error has the interval as this host resolved it.

    So the next owner does not resolve the meta-times of the get a second time.
    """
    found = pending.interval
    if error.reason != "MOVED" or found is None:
        return error
    bounds = {"start_unix_nano": str(found.start), "end_unix_nano": str(found.end)}
    return error_for(error.reason, error.message, {**error.metadata, **bounds})


def instant_key(get: WaitingGet) -> Key:
    """The sort key by instant, then by arrival."""
    assert get.instant is not None, "only gets with an instant are in the order of the instants"
    return get.instant, get.arrival


def need_key(position: int) -> Callable[[WaitingGet], Key]:
    """The sort key by one need, then by arrival."""

    def key(get: WaitingGet) -> Key:
        need = get.needs[position]
        assert need is not None, "a get without a need is not in the order of that need"
        return need, get.arrival

    return key


NEED_KEYS = tuple(need_key(position) for position in range(len(Needs._fields)))
