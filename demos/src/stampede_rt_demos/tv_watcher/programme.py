"""The streams of the programme: their hosts and their sources. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND

CAPTION_NANOS = NANOS_PER_SECOND
AUDIO_BLOCK_NANOS = 125_000_000
AUDIO_RATE_HZ = 48_000
FRAME_WIDTH = 640
FRAME_HEIGHT = 360
JPEG_QUALITY = 85
STREAM_MAX_AGE = "15s"
GROUP = "tv/programme"


@dataclass(frozen=True, kw_only=True, slots=True)
class StreamPlan:
    """One stream and its channel. `host_index` counts the cluster's hosts in the order of their names."""

    name: str
    channel: str
    content_type: str
    host_index: int


CAPTIONS = StreamPlan(name="captions", channel="tv/captions", content_type="text/plain;charset=utf-8", host_index=0)
VIDEO = StreamPlan(name="video", channel="tv/video", content_type="image/jpeg", host_index=0)
AUDIO = StreamPlan(
    name="audio",
    channel="tv/audio",
    content_type=f"audio/pcm;format=s16le;rate={AUDIO_RATE_HZ};channels=1",
    host_index=1,
)
MOTION = StreamPlan(name="motion", channel="tv/motion", content_type="application/json", host_index=1)
LOUDNESS = StreamPlan(name="loudness", channel="tv/loudness", content_type="application/json", host_index=0)

STREAMS = (CAPTIONS, VIDEO, AUDIO, MOTION, LOUDNESS)
SOURCE_OF_FEATURE = {MOTION.name: VIDEO.name, LOUDNESS.name: AUDIO.name}
"""A feature's items have the times and durations of the items that they were made from (paper, section 3.1)."""
