"""The ends of the spans of one bucket (paper, section 3.2). Pure."""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.run import ABSENT, Slice


def latest_end(bucket: Iterator[Slice], time: int, bound: int) -> int:
    """The latest span end of items at `time`. The next bucket's time `bound` limits them."""
    longest = 0
    for part in bucket:
        durations = part.run.durations
        if durations is None:
            return bound
        for duration in durations[part.lo : part.hi]:
            if duration == ABSENT or time + duration >= bound:
                return bound
            longest = max(longest, duration)
    return min(time + longest, bound)


def end_of_newest(bucket: Iterator[Slice], time: int, now: int) -> int:
    """The latest span end of items in the newest bucket.

    Durations have no limit there, and open spans hold until `now`.
    """
    ends = [time]
    for part in bucket:
        durations = part.run.durations
        for duration in (ABSENT,) if durations is None else durations[part.lo : part.hi]:
            ends.append(max(now, time) if duration == ABSENT else time + duration)
    return max(ends)
