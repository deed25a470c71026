"""The ends of the spans of one bucket (paper, section 3.2). Pure."""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.run import ABSENT, Slice

SLICES_MAX = 512
"""The most slices of a bucket at which one call looks. The call assumes that the spans of a larger bucket are as long
as possible. The caller asks at each change, and a look at all slices would hold the event loop each time.
"""


def latest_end(bucket: Iterator[Slice], time: int, bound: int) -> int:
    """The latest span end of items at `time`, at most `bound`, the next bucket's time."""
    longest = 0
    for looked_at, part in enumerate(bucket):
        durations = None if part.run.durations is None else part.run.durations[part.lo : part.hi]
        if looked_at >= SLICES_MAX or durations is None or ABSENT in durations:
            return bound
        longest = max(longest, max(durations))
        if time + longest >= bound:
            return bound
    return time + longest


def end_of_newest(bucket: Iterator[Slice], time: int, now: int, bound: int) -> int:
    """The latest span end of items in the newest bucket. No span of the bucket ends later than at `bound`.

    Durations have no limit there, and open spans hold until `now`.
    """
    end = time
    for looked_at, part in enumerate(bucket):
        if looked_at >= SLICES_MAX:
            return bound
        durations = None if part.run.durations is None else part.run.durations[part.lo : part.hi]
        if durations is None or ABSENT in durations:
            end = max(end, now)
        if durations is not None:
            end = max(end, time + max(durations))
    return end
