"""The planner: watches the newest disparity, asks the mapper when an object is near, and goes on or stops."""

from __future__ import annotations

import json
import sys
import time

import stampede_rt as st
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.statistics import percentile
from stampede_rt_demos.stereo.programme import (
    DEPTH_CHANNEL,
    DISPARITY_MAX,
    DISPARITY_MIN,
    END_DISPARITY,
    END_NUMBER,
    MAPPER,
    PLANNER,
)

NEAR_PIXELS = (DISPARITY_MIN + DISPARITY_MAX) // 2
ANSWER_SECONDS = 3.0
LOOK_SECONDS = 0.5


def play(stage: Stage) -> dict[str, object]:
    """Ask whenever the newest disparity is near.

    There is one question at a time, so that the newest value always counts.
    """
    stops, unanswered = 0, 0
    round_trips: list[int] = []
    with st.connect(stage.settings.address, name=PLANNER) as rt:
        depth = rt.channel(DEPTH_CHANNEL, codec="json", create=False)
        stage.wait_for_start()
        seen: st.Item | None = None
        while True:
            item = depth.newest(after=seen, timeout=LOOK_SECONDS)
            if item is None:
                continue
            seen = item
            if item.value["disparity"] == END_DISPARITY:
                break
            if item.value["disparity"] < NEAR_PIXELS:
                continue
            began = time.perf_counter_ns()
            median = ask(rt, item.time, number=len(round_trips))
            if median is None:
                unanswered += 1
                continue
            round_trips.append(time.perf_counter_ns() - began)
            stops += median >= NEAR_PIXELS
            stage.send_progress(items=len(round_trips))
        rt.send(MAPPER, json.dumps({"number": END_NUMBER}).encode())
    return {
        "answers": len(round_trips),
        "unanswered": unanswered,
        "stops": stops,
        "round_trip_p50_nanos": percentile(round_trips, 50),
        "round_trip_p99_nanos": percentile(round_trips, 99),
    }


def ask(rt: st.Connection, at: int, number: int) -> float | None:
    """Return the mapper's answer about the second before `at`; None without an answer, or if it has no value."""
    question = {"from": PLANNER, "number": number, "time": at}
    rt.send(MAPPER, json.dumps(question).encode())
    while (answer := rt.mailbox.get(timeout=ANSWER_SECONDS)) is not None:
        with answer:
            decoded = json.loads(answer.payload)
        if decoded["number"] == number:
            median: float | None = decoded["median"]
            return median
    return None


if __name__ == "__main__":
    sys.exit(run_role(play))
