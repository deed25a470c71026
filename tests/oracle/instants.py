"""Sets of instants over continuous time: all instants between two bounds, each inclusive or exclusive."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.values.timeline import ResolvedInterval


@dataclass(frozen=True)
class Instants:
    """All instants between `low` and `high`, with the bounds that are closed."""

    low: int
    high: int
    low_closed: bool = True
    high_closed: bool = True

    @classmethod
    def of(cls, interval: ResolvedInterval) -> Instants:
        return cls(interval.start, interval.end, not interval.start_exclusive, not interval.end_exclusive)

    @property
    def is_empty(self) -> bool:
        """Whether the set has no instant.

        Two different bounds always have an instant between them. Equal bounds have one only if both are closed.
        """
        return self.low > self.high or (self.low == self.high and not (self.low_closed and self.high_closed))

    def shares_an_instant_with(self, other: Instants) -> bool:
        """Whether some instant lies in both sets: the set from the later low bound to the earlier high bound is not
        empty.
        """
        low = max(self.low, other.low)
        high = min(self.high, other.high)
        low_closed = all(one.low_closed for one in (self, other) if one.low == low)
        high_closed = all(one.high_closed for one in (self, other) if one.high == high)
        return not Instants(low, high, low_closed, high_closed).is_empty

    def holds(self, instant: int) -> bool:
        return self.shares_an_instant_with(Instants(instant, instant))

    def lies_in(self, other: Instants) -> bool:
        """Whether the set is not empty, and all its instants lie in the other set."""
        low_fits = self.low > other.low or (self.low == other.low and (other.low_closed or not self.low_closed))
        high_fits = self.high < other.high or (self.high == other.high and (other.high_closed or not self.high_closed))
        return not self.is_empty and low_fits and high_fits
