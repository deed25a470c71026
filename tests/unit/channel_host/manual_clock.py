"""A clock that stands until it is moved."""

from __future__ import annotations


class ManualClock:
    def __init__(self, time_unix_nano: int = 1_700_000_000_000_000_000) -> None:
        self.wall = time_unix_nano
        self.boot = 10**12

    def time_unix_nano(self) -> int:
        return self.wall

    def boottime_nanos(self) -> int:
        return self.boot

    def advance(self, nanos: int) -> None:
        self.wall += nanos
        self.boot += nanos
