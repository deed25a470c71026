"""Remembers recent log messages of this process, so that it does not repeat them. Pure."""

from __future__ import annotations

from collections.abc import Hashable

REPEAT_SECONDS_MIN = 600.0
REPORTS_MAX = 256


class ReportLimiter:
    """Lets each report be logged once in REPEAT_SECONDS_MIN. Remembers the REPORTS_MAX newest reports."""

    def __init__(self) -> None:
        self._logged_at: dict[Hashable, float] = {}

    def is_due(self, report: Hashable, now: float) -> bool:
        """Whether to log the report at `now` (seconds). If this is True, the report counts as logged."""
        logged_at = self._logged_at.get(report)
        if logged_at is not None and now - logged_at < REPEAT_SECONDS_MIN:
            return False
        self._logged_at.pop(report, None)
        self._logged_at[report] = now
        if len(self._logged_at) > REPORTS_MAX:
            del self._logged_at[next(iter(self._logged_at))]
        return True
