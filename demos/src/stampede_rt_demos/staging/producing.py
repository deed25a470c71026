"""Puts planned items when they are due. All producers use this real-time loop."""

from __future__ import annotations

import time
from collections.abc import Iterable

import stampede_rt as st
from stampede_rt_demos.staging.role import Stage
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND, PlannedItem
from stampede_rt_demos.staging.statistics import percentile

PUT_TIME_ATTRIBUTE = "put_unix_nano"
PUT_TIMEOUT_SECONDS = 5.0


def wait_until(unix_nano: int) -> None:
    """Sleep until the wall clock reaches `unix_nano`. Return immediately if the clock is already there."""
    while (delay := unix_nano - time.time_ns()) > 0:
        time.sleep(delay / NANOS_PER_SECOND)


def produce(stage: Stage, channel: st.Channel, plan: Iterable[PlannedItem], end: int) -> dict[str, object]:
    """Put every item of `plan` when it is due. Then promise that no item before `end` will come.

    An item that is due at its end gets an advance to that end right after its put. A reader that waits for the interval
    up to that end then need not wait for the next item. Returns the figures for the producer's result: the number of
    items, the duration of the last item, and the latenesses. The lateness of an item is the time from the instant at
    which it is due to the beginning of its put.
    """
    lateness: list[int] = []
    period_nanos = 0
    for planned in plan:
        wait_until(planned.due)
        now = time.time_ns()
        lateness.append(now - planned.due)
        channel.put(
            planned.payload,
            time=planned.time,
            duration=planned.duration,
            attributes={PUT_TIME_ATTRIBUTE: str(now), "clip_nanos": str(planned.clip_nanos)},
            timeout=PUT_TIMEOUT_SECONDS,
        )
        if planned.due > planned.time:
            channel.advance(planned.due)
        period_nanos = planned.duration
        stage.send_progress(items=len(lateness))
    wait_until(end)
    channel.advance(end)
    return {
        "put": len(lateness),
        "period_nanos": period_nanos,
        "lateness_p99_nanos": percentile(lateness, 99),
        "lateness_max_nanos": max(lateness, default=None),
    }
