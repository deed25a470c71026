"""Counts the refusals at a service's own limits, and logs some of them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from stampede_rt.errors import Overloaded

logger = logging.getLogger(__name__)

LOG_PERIOD_NANOS = 10 * 10**9


class OverloadCounter:
    """Counts items or calls that a service refused as Overloaded.

    `now`: nanoseconds of a clock that never goes back.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._last_nanos: int | None = None
        self._logged = 0
        self._logged_nanos: int | None = None

    def note(self, count: int, now: int) -> int | None:
        """Count refusals. If a log line is due, returns the number of refusals since the last line; otherwise None."""
        self.refused += count
        self._last_nanos = now
        if self._logged_nanos is not None and now - self._logged_nanos < LOG_PERIOD_NANOS:
            return None
        unlogged = self.refused - self._logged
        self._logged, self._logged_nanos = self.refused, now
        return unlogged

    def ago_nanos(self, now: int) -> int | None:
        """The time since the last refusal, in nanoseconds; None: there was none."""
        return None if self._last_nanos is None else now - self._last_nanos


class RefusedCalls:
    """Calls, and reads in streams, that were refused or ended as Overloaded. `steady_nanos` never goes back."""

    def __init__(self, steady_nanos: Callable[[], int] = time.monotonic_ns) -> None:
        self._overload = OverloadCounter()
        self._steady_nanos = steady_nanos

    def note(self, error: Overloaded) -> None:
        """Count a refusal. Writes a log line every 10 s at most."""
        unlogged = self._overload.note(1, self._steady_nanos())
        if unlogged is not None:
            logger.warning(
                "calls are refused", extra={"event": "calls_refused", "calls": unlogged, "why": error.message}
            )

    @property
    def count(self) -> int:
        """The number of refusals so far."""
        return self._overload.refused

    def ago_nanos(self) -> int | None:
        """The time since the last refusal, in nanoseconds; None: there was none."""
        return self._overload.ago_nanos(self._steady_nanos())
