"""How items are matched: the arguments of `Group.match`. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.values.grouping import parse_lateness, parse_tolerance
from stampede_rt.values.policy import flag_of
from stampede_rt.values.timeline import Bound, BoundLike, DurationLike, parse_bound


@dataclass(frozen=True, kw_only=True, slots=True)
class MatchRule:
    """The arguments of `Group.match`. If `start` is None, only items that come after the call get a match."""

    tolerance_nanos: int
    lateness_nanos: int
    unique: bool
    partial: bool
    payloads: bool
    start: Bound | None

    @classmethod
    def parse(
        cls,
        tolerance: DurationLike,
        lateness: DurationLike,
        *,
        unique: bool,
        partial: bool,
        payloads: bool,
        start: BoundLike | None,
    ) -> MatchRule:
        """Check the arguments. Raises InvalidArgument."""
        return cls(
            tolerance_nanos=parse_tolerance(tolerance),
            lateness_nanos=parse_lateness(lateness),
            unique=flag_of("unique", unique),
            partial=flag_of("partial", partial),
            payloads=flag_of("payloads", payloads),
            start=None if start is None else parse_bound(start, "start"),
        )
