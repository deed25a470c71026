"""The data of the picture, from the viewer's last spans. They are small enough for one line to the orchestrator."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import stampede_rt as st
from stampede_rt_demos.staging.thumbnails import jpeg_thumbnail
from stampede_rt_demos.tv_watcher.features import envelope
from stampede_rt_demos.tv_watcher.programme import AUDIO, CAPTIONS, LOUDNESS, MOTION, VIDEO
from stampede_rt_demos.tv_watcher.spans import Span

PICTURE_SPANS_MAX = 6
THUMBNAIL_WIDTH = 272
THUMBNAIL_HEIGHT = 153
THUMBNAIL_QUALITY = 85
ENVELOPE_BINS = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureSpan:
    """One caption and the items in its span. All times are nanoseconds since the start of the programme.

    `frames`: the frames' times; `thumbnail`: (time, JPEG) of the middle frame; `motion`: (time, energy, cut);
    `loudness`: (time, duration, dBFS); `sound`: (time, duration, lowest and highest sample of equal parts).
    """

    start: int
    end: int
    text: str
    frames: Sequence[int]
    thumbnail: tuple[int, bytes]
    sound: Sequence[tuple[int, int, Sequence[tuple[float, float]]]]
    motion: Sequence[tuple[int, float, bool]]
    loudness: Sequence[tuple[int, int, float]]


def picture_record(spans: Iterable[Span], start: int) -> dict[str, object]:
    """Return the spans as fields of a `picture` event. Spans without a caption or without frames are left out."""
    return {"spans": [_span_record(span, start) for span in spans if span[CAPTIONS.name] and span[VIDEO.name]]}


def picture_spans(record: Mapping[str, object]) -> list[PictureSpan]:
    """Return the spans of a `picture` event, with decoded thumbnails."""
    spans = record["spans"]
    assert isinstance(spans, list)
    return [PictureSpan(**{**span, "thumbnail": _decoded(*span["thumbnail"])}) for span in spans]


def _span_record(span: Span, start: int) -> dict[str, object]:
    caption, frames = span[CAPTIONS.name][0], span[VIDEO.name]
    middle = frames[len(frames) // 2]
    features = [(item, json.loads(item.payload or b"{}")) for item in span[MOTION.name]]
    levels = [(item, json.loads(item.payload or b"{}")) for item in span[LOUDNESS.name]]
    return {
        "start": caption.time - start,
        "end": caption.time + (caption.duration or 0) - start,
        "text": (caption.payload or b"").decode(),
        "frames": [frame.time - start for frame in frames],
        "thumbnail": (middle.time - start, _thumbnail(middle)),
        "sound": [(block.time - start, block.duration, _envelope(block)) for block in span[AUDIO.name]],
        "motion": [(item.time - start, motion["energy"], motion["cut"]) for item, motion in features],
        "loudness": [(item.time - start, item.duration, level["rms_dbfs"]) for item, level in levels],
    }


def _thumbnail(frame: st.Item) -> str:
    small = jpeg_thumbnail(frame.payload or b"", THUMBNAIL_WIDTH, THUMBNAIL_HEIGHT, THUMBNAIL_QUALITY)
    return base64.b64encode(small).decode()


def _decoded(time: int, jpeg: str) -> tuple[int, bytes]:
    return time, base64.b64decode(jpeg)


def _envelope(block: st.Item) -> list[tuple[float, float]]:
    samples = np.frombuffer(block.payload or b"", dtype="<i2")
    return [(round(low, 4), round(high, 4)) for low, high in envelope(samples, ENVELOPE_BINS)]
