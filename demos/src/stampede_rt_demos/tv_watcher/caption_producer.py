"""The caption producer: puts one sentence a second about the picture of the clip."""

from __future__ import annotations

import sys

import stampede_rt as st
from stampede_rt_demos.staging.clip import video_loop_nanos
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.producing import produce
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.tv_watcher.captions import planned_captions
from stampede_rt_demos.tv_watcher.opening import open_channel
from stampede_rt_demos.tv_watcher.programme import CAPTION_NANOS, CAPTIONS


def play(stage: Stage) -> dict[str, object]:
    """Put every caption when it begins."""
    loop_nanos = video_loop_nanos(locate_film())
    length = stage.settings.length_nanos
    with st.connect(stage.settings.address, name="caption-producer") as rt:
        channel = open_channel(rt, CAPTIONS)
        start = stage.wait_for_start()
        plan = planned_captions(loop_nanos, CAPTION_NANOS, start, length)
        return produce(stage, channel, plan, start + length)


if __name__ == "__main__":
    sys.exit(run_role(play))
