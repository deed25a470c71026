"""The host's time, from the clocks of its machine."""

from __future__ import annotations

from stampede_rt_channel_host.core.host_clock import HostTime
from stampede_rt_channel_host.core.ring_writer import ClockReading
from stampede_rt_runtime.clock import HostClock


class HostClocks:
    """Reads the clocks of the machine, and gives the host's time."""

    def __init__(self, clock: HostClock) -> None:
        self._clock = clock
        self._time = HostTime(clock.boottime_nanos(), clock.time_unix_nano())

    def now(self) -> int:
        """Nanoseconds since the Unix epoch, slewed, never stepping."""
        return self._time.read(self._clock.boottime_nanos(), self._clock.time_unix_nano())

    def read(self) -> ClockReading:
        """The host's time at a reading of CLOCK_BOOTTIME, for readers of rings."""
        boottime = self._clock.boottime_nanos()
        host_unix = self._time.read(boottime, self._clock.time_unix_nano())
        return ClockReading(boottime, host_unix, self._time.offset_nanos)
