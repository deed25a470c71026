"""The rover: hosts the channels of its two cameras in its own process, puts their frames, and performs the commands
in its mailbox.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
from PIL import Image

import stampede_rt as st
from stampede_rt_demos.rover.programme import DEPTH_SECONDS_MAX, RIG, STREAM_MAX_AGE, is_taken
from stampede_rt_demos.staging.clip import EncodedVideo
from stampede_rt_demos.staging.producing import wait_until
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.thumbnails import encode_jpeg, luma_thumbnail
from stampede_rt_demos.stereo.camera import NUMBER_ATTRIBUTE, clip, put_end
from stampede_rt_demos.stereo.programme import (
    DEPTH_CHANNEL,
    END_NANOS,
    GROUP,
    HEIGHT,
    JPEG_QUALITY,
    Frame,
    Side,
    planned,
    true_disparity,
)
from stampede_rt_demos.stereo.scene import WIDE, view

LOOK_SECONDS = 0.2


def play(stage: Stage) -> dict[str, object]:
    """Put each frame at its time, except the lost frames. Then report the end to the consumers, and wait for the last
    disparity.
    """
    video = clip()
    wide = [luma_thumbnail(frame, WIDE, HEIGHT) for frame in video.frames]
    speeds: list[int] = []
    took: list[tuple[int, int]] = []
    ended = threading.Event()
    with st.host(stage.settings.address, name=RIG) as rt:
        cameras = {side: rt.channel(side.value, max_age=STREAM_MAX_AGE, content_type="image/jpeg") for side in Side}
        rt.group(GROUP, [*cameras.values()], reference="oldest")
        performing = threading.Thread(target=_perform_commands, args=(rt, ended, speeds), name="mailbox", daemon=True)
        performing.start()
        start = stage.wait_for_start()
        by_reference = 0
        for side, frame in _in_time(video, start, stage.settings.length_nanos):
            shown = view(wide[frame.number % len(wide)], side, true_disparity(frame.number))
            jpeg = encode_jpeg(Image.fromarray(np.ascontiguousarray(shown)), JPEG_QUALITY)
            wait_until(frame.time)
            began = time.perf_counter_ns()
            cameras[side].put(jpeg, time=frame.time, attributes={NUMBER_ATTRIBUTE: str(frame.number)})
            took.append((frame.time - start, time.perf_counter_ns() - began))
            newest = cameras[side].newest() if cameras[side].host == RIG else None
            by_reference += newest is not None and newest.payload is jpeg
            stage.send_progress(items=len(took))
        wait_until(start + stage.settings.length_nanos)
        for camera in cameras.values():
            put_end(camera, start + stage.settings.length_nanos)
        _wait_for_depth(rt, start + stage.settings.length_nanos + END_NANOS)
        ended.set()
        performing.join()
    return {"put": took, "by_reference": by_reference, "speeds": speeds}


def _in_time(video: EncodedVideo, start: int, length: int) -> Iterator[tuple[Side, Frame]]:
    """The frames of both cameras that are not lost, in the order of their times."""
    both = [(side, frame) for side in Side for frame in planned(side, video.clock, start, length)]
    put = [(side, frame) for side, frame in both if is_taken(frame.number) and not frame.is_lost]
    return iter(sorted(put, key=lambda one: one[1].time))


def _wait_for_depth(rt: st.Connection, end: int) -> None:
    """Stay a host until the depth consumer has put its last item, which has the time `end`.

    One of the cluster's two hosts is lost, so the channels of the other host have their replicas at this host.
    """
    depth = rt.channel(DEPTH_CHANNEL, codec="json", create=False)
    depth.get(end, end, match="start", timeout=DEPTH_SECONDS_MAX)


def _perform_commands(rt: st.Connection, ended: threading.Event, speeds: list[int]) -> None:
    """Perform the commands in the mailbox until the end."""
    while not ended.is_set():
        try:
            message = rt.mailbox.get(timeout=LOOK_SECONDS)
        except st.StampedeError:  # the host of the mailbox is lost; the peer gets another mailbox
            ended.wait(LOOK_SECONDS)
            continue
        if message is not None:
            with message:
                speeds.append(json.loads(message.payload)["speed"])


if __name__ == "__main__":
    sys.exit(run_role(play))
