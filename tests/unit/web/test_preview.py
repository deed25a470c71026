"""Unit tests of `stampede_rt_web.preview` and `.png`: every payload has a bounded preview in JSON."""

from __future__ import annotations

import json
import struct
import tracemalloc
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies

from stampede_rt.values.codecs import NumpyCodec
from stampede_rt_web.png import SIDE_MAX, png_of
from stampede_rt_web.preview import TEXT_CHARACTERS_MAX, hex_lines, numbers_in, picture_of, preview_of

TYPES = ["", "image/png", "image/jpeg", "image/svg+xml", "text/html", "application/json", "application/x-npy"]
AUDIO = "audio/pcm;format=s16le;rate=16000;channels=1"


def pixels_of(png: bytes | None) -> Any:
    """Decode the PNGs of this product: 8 bits, no filter, one IDAT."""
    assert png is not None
    width, height, _, colour, *_ = struct.unpack(">IIBBBBB", png[16:29])
    at = png.index(b"IDAT")
    rows = zlib.decompress(png[at + 4 : at + 4 + struct.unpack(">I", png[at - 4 : at])[0]])
    channels = {0: 1, 2: 3, 6: 4}[colour]
    return np.frombuffer(rows, np.uint8).reshape(height, 1 + width * channels)[:, 1:].reshape(height, width, channels)


def test_the_png_of_a_colour_array_has_the_same_pixels() -> None:
    array = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)
    assert (pixels_of(png_of(array)) == array).all()


def test_numbers_are_spread_from_black_to_white_and_a_large_array_is_thinned() -> None:
    array = np.linspace(-3.0, 9.0, 4 * SIDE_MAX * 8).reshape(4 * SIDE_MAX, 8)
    array[0, 0] = np.nan
    pixels = pixels_of(png_of(array))
    assert pixels.shape == (SIDE_MAX, 2, 1)
    assert pixels.min() == 0
    assert pixels.max() > 250


def test_a_constant_array_has_a_picture_and_a_vector_has_none() -> None:
    assert png_of(np.zeros((3, 3))) is not None
    assert png_of(np.zeros(9)) is None
    assert png_of(np.zeros((3, 3, 7))) is None
    assert png_of(np.zeros((3, 3), dtype="S4")) is None


def test_a_picture_whose_pixels_would_fill_the_browsers_memory_is_not_shown() -> None:
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 30_000, 30_000)
    assert picture_of("image/png", png) is None
    assert preview_of("image/png", png)["text"] == "A picture of 900,000,000 pixels is too large for this page."


def test_a_picture_is_recognised_by_its_first_bytes_and_svg_is_shown_as_text() -> None:
    jpeg = b"\xff\xd8\xff\xc0\0\x08\x08\0\x04\0\x05 rest"
    assert picture_of("image/jpeg", jpeg) == ("image/jpeg", jpeg)
    assert picture_of("image/jpeg", b"<script>") is None
    assert preview_of("image/svg+xml", b"<svg onload='x'/>")["kind"] == "text"


def test_a_vector_is_a_plot_and_nan_values_are_left_out() -> None:
    shown = preview_of("application/x-npy", NumpyCodec().encode(np.array([1.0, np.nan, 3.0])))
    assert (shown["kind"], shown["values"], shown["shape"]) == ("plot", [1.0, None, 3.0], [3])


def test_sound_is_a_wave_between_minus_one_and_one() -> None:
    samples = np.array([0, 32767, -32768, 5], dtype="<i2").tobytes()
    shown = preview_of(AUDIO, samples + b"\0")
    assert (shown["kind"], shown["samples"], shown["rate_hz"]) == ("wave", 4, 16000)
    assert min(one[0] for one in shown["wave"]) == -1.0
    assert preview_of(AUDIO, b"")["wave"] == []


def test_json_shows_its_numbers_by_name() -> None:
    shown = preview_of("application/json", b'{"x": 1.5, "ok": true, "label": "a", "big": 1e400}')
    assert (shown["kind"], shown["numbers"]) == ("json", {"x": 1.5})
    assert numbers_in(7) == {"value": 7.0}
    assert numbers_in(10**400) == {}


@pytest.mark.parametrize(
    "payload", [b"[" * 100_000, b'"\\ud800"', b"1" * 5000, b"NaN"], ids=["deep", "surrogate", "long", "nan"]
)
def test_unusual_json_still_has_a_preview(payload: bytes) -> None:
    preview = preview_of("application/json", payload)
    assert preview
    json.dumps(preview, allow_nan=False).encode()


def test_a_header_that_claims_a_huge_array_has_a_preview_as_bytes() -> None:
    text = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117) + b"\n"
    assert preview_of("application/x-npy", b"\x93NUMPY\x01\x00v\x00" + text)["kind"] == "hex"


def test_bytes_are_shown_as_hexadecimal_lines() -> None:
    assert hex_lines(b"\x00A" * 9).splitlines()[1] == "0010  " + "00 41".ljust(47) + "  .A"


@given(strategies.sampled_from([*TYPES, AUDIO, "text/plain"]), strategies.binary(max_size=3000))
def test_any_payload_of_any_type_has_a_small_preview_in_json(content_type: str, payload: bytes) -> None:
    shown = preview_of(content_type, payload)
    assert shown["kind"] in ("picture", "plot", "wave", "json", "text", "hex")
    assert len(json.dumps(shown, allow_nan=False)) < 64_000


def test_deep_and_long_json_is_indented_only_as_far_as_it_is_shown() -> None:
    payload = b"[" * 200 + b"1," * 50_000 + b"1" + b"]" * 200
    tracemalloc.start()
    try:
        shown = preview_of("application/json", payload)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert shown["kind"] == "json"
    assert len(shown["text"]) == TEXT_CHARACTERS_MAX + 1
    assert most < 5_000_000
