"""The ends of the spans of one bucket (paper, section 3.2). Pure."""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.run import ABSENT, Slice

SLICES_MAX = 512
"""The most slices of a bucket at which one call looks. If the bucket has more slices, the call returns the latest end
that is possible. A look at all slices at each change of the channel would hold the event loop too long.
"""


def latest_end(bucket: Iterator[Slice], time: int, bound: int) -> int:
    """The latest span end of the items of the bucket at `time`. `bound`, the next bucket's time, ends every span."""
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
    """The latest span end of the items of the newest bucket, which begins at `time`.

    No later bucket ends these spans. So each span lasts for its whole duration, or until `now` if it has no duration.
    `bound` is the latest span end of the whole bucket, of which `bucket` may be a part.
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
