"""The host's own view of its lease (paper, section 4.3). Pure: every method takes nanoseconds of CLOCK_BOOTTIME.

The directory ends a lease at the earliest one TTL after it *received* a renewal. The host stops serving 0.8 TTL after
it *sent* the last acknowledged renewal. So the host stops first, on every clock, however long the answer took.
"""

from __future__ import annotations

from dataclasses import dataclass

RENEWALS_PER_TTL = 3
_FENCE_NUMERATOR, _FENCE_DENOMINATOR = 4, 5


@dataclass(slots=True)
class HostLease:
    """One lease. The host does not hold it before the first `granted`."""

    ttl_nanos: int = 0
    _sent_nanos: int = 0
    _fence_nanos: int | None = None

    def granted(self, *, sent_nanos: int, ttl_nanos: int) -> None:
        """Note that the directory acknowledged the renewal sent at `sent_nanos`.

        If the answer to a later renewal came before, this answer changes nothing.
        """
        if self._fence_nanos is not None and sent_nanos <= self._sent_nanos:
            return
        self.ttl_nanos = ttl_nanos
        self._sent_nanos = sent_nanos
        self._fence_nanos = sent_nanos + ttl_nanos * _FENCE_NUMERATOR // _FENCE_DENOMINATOR

    def give_up(self) -> None:
        """Stop serving until the next grant: the directory has ended the lease, or the host leaves."""
        self._fence_nanos = None

    def is_held(self, now: int) -> bool:
        """Whether the host may serve its channels at `now`."""
        return self._fence_nanos is not None and now < self._fence_nanos

    def fenced_in_nanos(self, now: int) -> int:
        """The time in nanoseconds that the host may serve from `now` on; 0 if it may not serve."""
        return max(0, self._fence_nanos - now) if self._fence_nanos is not None else 0

    def renewal_in_nanos(self, now: int) -> int:
        """The nanoseconds from `now` to the next renewal; 0 if it is due or the host holds no lease."""
        if self._fence_nanos is None:
            return 0
        return max(0, self._sent_nanos + self.ttl_nanos // RENEWALS_PER_TTL - now)
