"""The picture is a PNG that shows the given items, and stays small enough for a page."""

import importlib
import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image, ImageColor

from stampede_rt.values.model import Item
from stampede_rt_demos.staging.thumbnails import encode_jpeg
from stampede_rt_demos.tv_watcher.picture_data import PictureSpan, picture_record, picture_spans

SECOND, FRAME, BLOCK = 1_000_000_000, 40_000_000, 125_000_000
START = 1_700_000_000_000_000_000


def item(time: int, duration: int, payload: bytes) -> Item:
    return Item(START + time, None, duration, 1, payload, {}, "", len(payload), 1)


def span_items(number: int) -> dict[str, list[Item]]:
    """One second of all streams on synthetic media: a picture that brightens, a tone, a cut in span 1."""
    begin = number * SECOND
    frames = [begin + n * FRAME for n in range(25)]
    blocks = [begin + n * BLOCK for n in range(8)]
    tone = (np.sin(np.arange(6000) / 20) * 8000).astype("<i2").tobytes()
    jpeg = encode_jpeg(Image.new("RGB", (64, 36), (40 * number, 80, 120)), 85)
    return {
        "captions": [item(begin, SECOND, f"00:0{number}.00 caption number {number}".encode())],
        "video": [item(time, FRAME, jpeg) for time in frames],
        "audio": [item(time, BLOCK, tone) for time in blocks],
        "motion": [
            item(time, FRAME, json.dumps({"energy": 0.01, "cut": number == 1 and time == frames[10]}).encode())
            for time in frames
        ],
        "loudness": [item(time, BLOCK, b'{"rms_dbfs": -30.0}') for time in blocks],
    }


@pytest.fixture
def picture() -> ModuleType:
    """The module that draws. An import at the top of this file would load matplotlib in each process that collects
    tests.
    """
    return importlib.import_module("stampede_rt_demos.tv_watcher.timeline_picture")


@pytest.fixture
def spans() -> list[PictureSpan]:
    record = json.loads(json.dumps(picture_record([span_items(number) for number in range(3)], START)))
    return picture_spans(record)


def test_the_drawn_data_is_the_same_after_encoding_as_a_line(spans):
    second = spans[1]
    assert (second.start, second.end, second.text) == (SECOND, 2 * SECOND, "00:01.00 caption number 1")
    assert (len(second.frames), len(second.motion), len(second.sound), len(second.loudness)) == (25, 25, 8, 8)
    assert second.frames[1] == SECOND + FRAME
    assert second.thumbnail[0] == SECOND + 12 * FRAME
    assert second.thumbnail[1].startswith(b"\xff\xd8")
    assert [time for time, _, cut in second.motion if cut] == [SECOND + 10 * FRAME]


def test_a_span_without_frames_is_left_out():
    record = picture_record([{**span_items(0), "video": []}, span_items(1)], START)
    assert [span.start for span in picture_spans(json.loads(json.dumps(record)))] == [SECOND]


def test_the_picture_shows_every_stream_in_its_colour(picture: ModuleType, spans, tmp_path: Path):
    path = tmp_path / "picture.png"
    picture.draw(spans, path, "a subtitle")
    with Image.open(path) as image:
        assert image.format == "PNG"
        pixels = np.asarray(image.convert("RGB"))
    assert pixels.shape[1] > 1200
    for colour in (picture.BLUE, picture.ORANGE, picture.GREEN, picture.VERMILION):
        assert (pixels == ImageColor.getrgb(colour)).all(axis=2).sum() > 50, colour
    assert path.stat().st_size < 400_000


def test_without_spans_there_is_no_picture(picture: ModuleType, tmp_path: Path):
    with pytest.raises(ValueError, match="nothing to draw"):
        picture.draw([], tmp_path / "picture.png", "")
    assert not (tmp_path / "picture.png").exists()
