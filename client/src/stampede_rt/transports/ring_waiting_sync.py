"""Waits for changes of rings, on the calling thread. `ring_waiting_async` has the same names for asyncio."""

from __future__ import annotations

from stampede_rt.transports.ring_mapping import RingMapping


class RingWaits:
    """Waits for rings. Each caller waits by a system call of its own, and needs no other thread."""

    def __init__(self) -> None:
        self.waiting = 0
        """About how many callers wait."""

    def wait(self, mapping: RingMapping, changes: int, timeout_s: float) -> bool:
        """Wait until the ring changes, for at most `timeout_s` and WAIT_S_MAX. Returns True.

        `changes` is the number of changes before the caller's last look.
        """
        self.waiting += 1
        try:
            mapping.wait(changes, timeout_s)
        finally:
            self.waiting -= 1
        return True

    def wake(self, mapping: RingMapping) -> None:
        """End all waits for a ring, so that their callers look again."""
        mapping.wake()

    def close(self) -> None:
        """Do nothing: `RingMapping.close` ends the waits."""
