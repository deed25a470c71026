"""The depth consumer: measures the disparity of every pair, and puts it with the time of the left frame."""

from __future__ import annotations

import base64
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import stampede_rt as st
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.stereo.camera import picture_of
from stampede_rt_demos.stereo.matching import Pair, ignore, number_of, pairs_of, take_pairs
from stampede_rt_demos.stereo.programme import DEPTH_CHANNEL, END_DISPARITY, END_NANOS, GROUP, Side, true_disparity
from stampede_rt_demos.stereo.scene import measured_disparity


def play(stage: Stage) -> dict[str, object]:
    """Measure until the programme's end."""
    measured: list[tuple[int, int, int]] = []
    last: list[Pair] = []
    with ExitStack() as stack:
        rt = stack.enter_context(st.connect(stage.settings.address, name="depth"))
        depth = rt.channel(DEPTH_CHANNEL, codec="json", create=False)
        group = rt.group(GROUP)
        by_left = stack.enter_context(pairs_of(group, Side.LEFT, payloads=True))
        by_right = stack.enter_context(pairs_of(group, Side.RIGHT, payloads=False))
        start = stage.wait_for_start()

        def handle(pair: Pair) -> None:
            left, right = pair
            disparity = measured_disparity(picture_of(left.payload or b""), picture_of(right.payload or b""))
            depth.put({"disparity": disparity}, time=left.time)
            measured.append((left.time - start, disparity, true_disparity(number_of(left))))
            last[:] = [pair]
            stage.send_progress(items=len(measured))

        threads = stack.enter_context(ThreadPoolExecutor(1))
        right_outcome = threads.submit(take_pairs, by_right, Side.RIGHT, ignore)
        left_outcome = take_pairs(by_left, Side.LEFT, handle)
        depth.put({"disparity": END_DISPARITY}, time=start + stage.settings.length_nanos + END_NANOS)
        records = {"left": left_outcome.as_record(), "right": right_outcome.result().as_record()}
    stage.send_event(
        "picture", frames=[base64.b64encode(item.payload or b"").decode() for pair in last for item in pair]
    )
    return {**records, "measured": measured}


if __name__ == "__main__":
    sys.exit(run_role(play))
