"""A camera: puts its view of the clip in real time, with wrong times, and loses some frames."""

from __future__ import annotations

import io
import time
from collections.abc import Sequence

import numpy as np
from PIL import Image

import stampede_rt as st
from stampede_rt_demos.staging.clip import EncodedVideo, decode_video
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.producing import wait_until
from stampede_rt_demos.staging.role import Stage
from stampede_rt_demos.staging.statistics import percentile
from stampede_rt_demos.staging.thumbnails import encode_jpeg, luma_thumbnail
from stampede_rt_demos.stereo.programme import (
    END_NANOS,
    END_NUMBER,
    HEIGHT,
    JPEG_QUALITY,
    Side,
    planned,
    true_disparity,
)
from stampede_rt_demos.stereo.scene import WIDE, Picture, view

NUMBER_ATTRIBUTE = "frame"
PUT_TIMEOUT_SECONDS = 5.0


def clip() -> EncodedVideo:
    """Return the film, wide enough for both views."""
    return decode_video(locate_film(), WIDE, HEIGHT, JPEG_QUALITY)


def picture_of(jpeg: bytes) -> Picture:
    """Return the brightness of a JPEG picture, in its full size."""
    with Image.open(io.BytesIO(jpeg)) as image:
        return np.asarray(image.convert("L"))


def film(stage: Stage, side: Side) -> dict[str, object]:
    """Put each frame at its time, except the lost ones. Then tell the consumers that no further frame will come."""
    video = clip()
    wide = [luma_thumbnail(frame, WIDE, HEIGHT) for frame in video.frames]
    length = stage.settings.length_nanos
    with st.connect(stage.settings.address, name=f"{side.name.lower()}-camera") as rt:
        channel = rt.channel(side.value, create=False)
        start = stage.wait_for_start()
        took: list[tuple[int, int]] = []
        for frame in planned(side, video.clock, start, length):
            if frame.is_lost:
                continue
            shown = view(wide[frame.number % len(wide)], side, true_disparity(frame.number))
            jpeg = encode_jpeg(Image.fromarray(np.ascontiguousarray(shown)), JPEG_QUALITY)
            wait_until(frame.time)
            began = time.perf_counter_ns()
            channel.put(
                jpeg, time=frame.time, attributes={NUMBER_ATTRIBUTE: str(frame.number)}, timeout=PUT_TIMEOUT_SECONDS
            )
            took.append((frame.time, time.perf_counter_ns() - began))
            stage.send_progress(items=len(took))
        wait_until(start + length)
        put_end(channel, start + length)
    return {"put": len(took), **_put_times(took, start + length // 2)}


def put_end(channel: st.Channel, end: int) -> None:
    """Put an item without a picture after the last frame. With the advance its match comes immediately."""
    channel.put(b"", time=end + END_NANOS, attributes={NUMBER_ATTRIBUTE: str(END_NUMBER)})
    channel.advance(end + 2 * END_NANOS)


def _put_times(took: Sequence[tuple[int, int]], middle: int) -> dict[str, object]:
    """Return the median time of a put before, and after, the second consumer joined."""
    before = [nanos for at, nanos in took if at < middle]
    after = [nanos for at, nanos in took if at >= middle]
    return {"put_p50_before_nanos": percentile(before, 50), "put_p50_after_nanos": percentile(after, 50)}
