"""The planner: joins while the rover drives, takes its pairs, and sends it a speed for the nearest object."""

from __future__ import annotations

import json
import sys

import stampede_rt as st
from stampede_rt_demos.rover.programme import PLANNER_JOINS, RIG
from stampede_rt_demos.staging.producing import wait_until
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.stereo.matching import Pair, pairs_of, take_pairs
from stampede_rt_demos.stereo.programme import DEPTH_CHANNEL, DISPARITY_MAX, END_DISPARITY, GROUP, Side

PAIRS_PER_COMMAND = 4
SEND_SECONDS = 2.0


def play(stage: Stage) -> dict[str, object]:
    """Take pairs from the moment of joining until the end, and steer by the newest disparity."""
    sent, unsent, pairs = 0, 0, 0
    with st.connect(stage.settings.address, name="planner") as rt:
        depth = rt.channel(DEPTH_CHANNEL, codec="json", create=False)
        start = stage.wait_for_start()
        wait_until(start + round(stage.settings.length_nanos * PLANNER_JOINS))

        def steer(_pair: Pair) -> None:
            nonlocal sent, unsent, pairs
            pairs += 1
            newest = depth.newest() if pairs % PAIRS_PER_COMMAND == 0 else None
            if newest is None or newest.value["disparity"] == END_DISPARITY:
                return
            command = json.dumps({"speed": DISPARITY_MAX - newest.value["disparity"]}).encode()
            try:
                rt.send(RIG, command, timeout=SEND_SECONDS)
                sent += 1
            except st.StampedeError:  # the mailbox was at the lost host
                unsent += 1

        with pairs_of(rt.group(GROUP), Side.LEFT, payloads=False) as matches:
            account = take_pairs(matches, Side.LEFT, steer)
    return {**account.as_record(), "sent": sent, "unsent": unsent}


if __name__ == "__main__":
    sys.exit(run_role(play))
