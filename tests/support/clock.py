"""A clock that stands still until a test moves it."""

from __future__ import annotations

from dataclasses import dataclass

_START_UNIX_NANO = 1_700_000_000 * 10**9


@dataclass(kw_only=True)
class ManualClock:
    """A HostClock with two clocks. `advance` moves both; `set_wall_clock` moves only the wall clock."""

    unix_nano: int = _START_UNIX_NANO
    boot_nanos: int = 10**9

    def time_unix_nano(self) -> int:
        return self.unix_nano

    def boottime_nanos(self) -> int:
        return self.boot_nanos

    def advance(self, nanos: int) -> None:
        self.unix_nano += nanos
        self.boot_nanos += nanos

    def set_wall_clock(self, unix_nano: int) -> None:
        """Set the wall clock, as an operator sets a machine's clock. The other clock does not move."""
        self.unix_nano = unix_nano
