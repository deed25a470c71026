"""The audio producer: puts the looped sound of the clip in blocks of 125 ms, as from a sound card."""

from __future__ import annotations

import sys

import stampede_rt as st
from stampede_rt_demos.staging.clip import decode_audio, one_loop, video_loop_nanos
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.producing import produce
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.schedule import planned_blocks
from stampede_rt_demos.tv_watcher.opening import open_channel
from stampede_rt_demos.tv_watcher.programme import AUDIO, AUDIO_BLOCK_NANOS, AUDIO_RATE_HZ


def play(stage: Stage) -> dict[str, object]:
    """Decode the whole sound first. Then put every block when its last sample is over."""
    path = locate_film()
    samples = one_loop(decode_audio(path, AUDIO_RATE_HZ), AUDIO_RATE_HZ, video_loop_nanos(path))
    length = stage.settings.length_nanos
    with st.connect(stage.settings.address, name="audio-producer") as rt:
        channel = open_channel(rt, AUDIO)
        start = stage.wait_for_start()
        plan = planned_blocks(samples, AUDIO_RATE_HZ, AUDIO_BLOCK_NANOS, start, length)
        return produce(stage, channel, plan, start + length)


if __name__ == "__main__":
    sys.exit(run_role(play))
