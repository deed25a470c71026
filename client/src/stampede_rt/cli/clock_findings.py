"""Findings about the clocks of a cluster's parts. The module is pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from stampede_rt.cli.observations import PEER, CheckResult, Observation
from stampede_rt.cli.output import roughly
from stampede_rt.values.timeline import format_duration

CLOCK_OFFSET_NANOS_MAX = 50_000_000  # a clock may differ from the other clocks by this much
UNKNOWN = "unknown"  # the text for a clock with an unknown offset


def clock_findings(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    """Yield one finding about the clocks of all parts, with advice about wrong clocks. Without offsets yields none.

    The median of the offsets of the services is the right time. A slow answer gives an inexact offset. If no offset of
    a service is exact enough, the finding says that the clocks are not known. A clock counts as wrong only if its
    distance from the right time is more than the sum of CLOCK_OFFSET_NANOS_MAX and the greatest errors of both offsets.
    """
    offsets = {one: one.clock_offset_nanos for one in seen if one.clock_offset_nanos is not None}
    certain = {one: offset for one, offset in offsets.items() if one.clock_doubt_nanos <= CLOCK_OFFSET_NANOS_MAX}
    services = [one for one in certain if one.kind != PEER]
    if not services:
        if offsets:
            quickest = format_duration(2 * min(one.clock_doubt_nanos for one in offsets))
            yield CheckResult(
                "clocks", "-", f"{UNKNOWN}: answers took {quickest} or longer, too long to compare clocks"
            )
        return
    middle = sorted(offsets[one] for one in services)[(len(services) - 1) // 2]
    doubt = max(one.clock_doubt_nanos for one in services)
    off = {
        one: offset - middle
        for one, offset in offsets.items()
        if is_off(offset - middle, doubt + one.clock_doubt_nanos)
    }
    advice = [f"the clock of {one.part} is {ahead(nanos)} the others'; synchronise it" for one, nanos in off.items()]
    if is_off(middle, 2 * doubt):
        advice.append(f"this machine's clock is {ahead(-middle)} the cluster's; synchronise this machine's")
    yield CheckResult(
        "clocks",
        "-",
        _apart(certain | {one: offsets[one] for one in off}),
        f"{'; '.join(advice)} (chrony, ntpd)" if advice else "",
    )


def _apart(offsets: Mapping[Observation, int]) -> str:
    """Return a text that says how far the clocks, also the caller's, are apart, and how exactly the caller knows it."""
    known = [(offset, one.clock_doubt_nanos) for one, offset in offsets.items()] + [(0, 0)]
    (high, high_doubt), (low, low_doubt) = max(known), min(known, key=lambda one: (one[0], -one[1]))
    return (
        f"{roughly(high - low)} +/- {roughly(high_doubt + low_doubt)} apart; "
        f"{format_duration(CLOCK_OFFSET_NANOS_MAX)} are allowed"
    )


def is_off(offset_nanos: int, uncertainty_nanos: int) -> bool:
    """Whether a clock is certainly wrong by more than the allowed offset."""
    return abs(offset_nanos) > CLOCK_OFFSET_NANOS_MAX + uncertainty_nanos


def ahead(offset_nanos: int) -> str:
    """Return an offset as a text such as "30 ms ahead of". The caller appends the owner of the other clock."""
    return f"{format_duration(abs(offset_nanos))} {'ahead of' if offset_nanos > 0 else 'behind'}"
