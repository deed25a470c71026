"""Remembers recent log messages of this process, so that it does not repeat them. Pure."""

from __future__ import annotations

from collections.abc import Hashable

AGAIN_SECONDS = 600.0
REPORTS_MAX = 256


class ReportLimiter:
    """Lets each report be logged once in AGAIN_SECONDS. Remembers the REPORTS_MAX newest reports."""

    def __init__(self) -> None:
        self._said_at: dict[Hashable, float] = {}

    def is_due(self, report: Hashable, now: float) -> bool:
        """Whether to log the report at `now` (seconds). If this is True, the report counts as logged."""
        said_at = self._said_at.get(report)
        if said_at is not None and now - said_at < AGAIN_SECONDS:
            return False
        self._said_at.pop(report, None)
        self._said_at[report] = now
        if len(self._said_at) > REPORTS_MAX:
            del self._said_at[next(iter(self._said_at))]
        return True
