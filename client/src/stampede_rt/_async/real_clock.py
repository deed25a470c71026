"""The clock of a connection, for programs that also run under the virtual clock of a replay."""

from __future__ import annotations

from time import time_ns

from stampede_rt.transports.concurrency_async import sleep
from stampede_rt.values.timeline import DurationLike, parse_duration


class RealClock:
    """The time of this machine. A `ReplayedConnection` has the same names with its virtual time."""

    @property
    def now(self) -> int:
        """The time of this machine's clock, in nanoseconds since the epoch."""
        return time_ns()

    async def sleep(self, duration: DurationLike) -> None:
        """Wait for `duration`, such as "100ms". Raises InvalidArgument."""
        await sleep(max(0, parse_duration(duration, "duration")) / 1e9)
