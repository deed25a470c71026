"""The mapper: knows the latest disparities, and answers the planner's questions, from mailbox to mailbox."""

from __future__ import annotations

import json
import statistics
import sys

import stampede_rt as st
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.stereo.programme import DEPTH_CHANNEL, END_NUMBER, MAPPER

PATIENCE_SECONDS = 0.2


def play(stage: Stage) -> dict[str, object]:
    """Answer every question with the median disparity of the second before it, until the planner ends."""
    answered = 0
    with st.connect(stage.settings.address, name=MAPPER) as rt:
        depth = rt.channel(DEPTH_CHANNEL, codec="json", create=False)
        stage.wait_for_start()
        while True:
            question = rt.mailbox.get(timeout=PATIENCE_SECONDS)
            if question is None:
                continue
            with question:  # acknowledges the question after the answer is sent
                decoded = json.loads(question.payload)
                if decoded["number"] == END_NUMBER:
                    return {"answered": answered}
                near = depth.get(decoded["time"] - NANOS_PER_SECOND, decoded["time"], match="start")
                median = statistics.median(item.value["disparity"] for item in near) if near else None
                rt.send(decoded["from"], json.dumps({"number": decoded["number"], "median": median}).encode())
                answered += 1


if __name__ == "__main__":
    sys.exit(run_role(play))
