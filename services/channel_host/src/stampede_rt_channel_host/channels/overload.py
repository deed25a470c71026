"""What a host refuses because a bound of its own is reached: counted, and told in the log now and then. Pure."""

from __future__ import annotations

LOG_PERIOD_NANOS = 10 * 10**9


class Overload:
    """Items of puts and enqueues that were refused as Overloaded, over all channels and queues of a host.

    `now`: nanoseconds of a clock that never goes back.
    """

    def __init__(self) -> None:
        self.refused_items = 0
        self._last_nanos: int | None = None
        self._logged_items = 0
        self._logged_nanos: int | None = None

    def note(self, items: int, now: int) -> int | None:
        """So many items were refused. Gives how many were since the last line of the log, if it is time for one."""
        self.refused_items += items
        self._last_nanos = now
        if self._logged_nanos is not None and now - self._logged_nanos < LOG_PERIOD_NANOS:
            return None
        untold = self.refused_items - self._logged_items
        self._logged_items, self._logged_nanos = self.refused_items, now
        return untold

    def ago_nanos(self, now: int) -> int | None:
        """How long ago the last one was refused; None: there was none."""
        return None if self._last_nanos is None else now - self._last_nanos
