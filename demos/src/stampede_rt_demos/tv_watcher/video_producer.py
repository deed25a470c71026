"""The video producer: puts the looped frames of the clip as JPEG, at the rate of the clip."""

from __future__ import annotations

import sys

import stampede_rt as st
from stampede_rt_demos.staging.clip import decode_video
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.producing import produce
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.schedule import planned_frames
from stampede_rt_demos.tv_watcher.opening import open_channel
from stampede_rt_demos.tv_watcher.programme import FRAME_HEIGHT, FRAME_WIDTH, JPEG_QUALITY, VIDEO


def play(stage: Stage) -> dict[str, object]:
    """Decode all frames first, so that the real-time loop only puts. Then put until the end of the programme."""
    video = decode_video(locate_film(), FRAME_WIDTH, FRAME_HEIGHT, JPEG_QUALITY)
    length = stage.settings.length_nanos
    with st.connect(stage.settings.address, name="video-producer") as rt:
        channel = open_channel(rt, VIDEO)
        start = stage.wait_for_start()
        plan = planned_frames(video.clock, video.frames, start, length)
        return produce(stage, channel, plan, start + length)


if __name__ == "__main__":
    sys.exit(run_role(play))
