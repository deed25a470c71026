"""Unit tests of `stampede_rt_web.picture_size`."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, strategies

from stampede_rt_web.picture_size import pixels_of

APP, FRAME, TABLE = 0xE0, 0xC2, 0xC4


def png(width: int, height: int, first: bytes = b"IHDR") -> bytes:
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, first, width, height) + b"\x08\x02\0\0\0"


def segment(marker: int, content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, 2 + len(content)) + content


def jpeg(width: int, height: int, *before: bytes) -> bytes:
    frame = segment(FRAME, struct.pack(">BHH", 8, height, width))
    return b"\xff\xd8" + b"".join(before) + frame + b"\xff\xda"


def test_a_png_has_the_pixels_of_its_first_chunk() -> None:
    assert pixels_of(png(30_000, 40_000)) == 1_200_000_000
    assert pixels_of(png(3, 4, first=b"tEXt")) is None


def test_the_size_of_a_jpeg_is_found_after_other_segments_and_padding() -> None:
    segments = segment(APP, b"Exif" * 9), b"\xff\xff", segment(TABLE, b"\xff\xc0 no frame")
    assert pixels_of(jpeg(65_535, 2, *segments)) == 131_070
    assert pixels_of(jpeg(5, 5, b"damage")) is None


def test_a_jpeg_with_very_many_segments_has_no_known_size() -> None:
    assert pixels_of(jpeg(5, 5, segment(APP, b"") * 2000)) is None


@pytest.mark.parametrize("whole", [png(3, 4), jpeg(3, 4, segment(APP, b"Exif"))])
def test_a_truncated_header_has_no_size(whole: bytes) -> None:
    sizes = {pixels_of(whole[:length]) for length in range(2, len(whole))}
    assert sizes == {None, 12}


@given(strategies.binary(max_size=200))
def test_the_size_of_any_bytes_is_found_without_an_error(payload: bytes) -> None:
    for start in (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"):
        found = pixels_of(start + payload)
        assert found is None or found >= 0
