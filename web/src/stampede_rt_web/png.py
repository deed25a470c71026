"""Arrays of pixels as PNG pictures. Pure. The standard library's zlib is enough, so the page needs no image library."""

from __future__ import annotations

import struct
import zlib
from typing import Any

SIDE_MAX = 512
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}  # grey, RGB, RGBA, by the number of values of a pixel


def png_of(array: Any) -> bytes | None:
    """Return a numpy array as a PNG of at most SIDE_MAX pixels on a side; None if it is not a picture.

    A picture has the shape (height, width), or (height, width, 1, 3 or 4). Numbers of other types than uint8 are
    scaled: the least shown number becomes black (0), the greatest white (255).
    """
    import numpy as np

    if array.ndim not in (2, 3) or min(array.shape[:2]) < 2 or array.dtype.kind not in "biuf":
        return None
    if array.ndim == 3 and array.shape[2] not in _COLOUR_TYPES:
        return None
    stride = -(-max(array.shape[:2]) // SIDE_MAX)
    shown = array[::stride, ::stride]
    if shown.dtype != np.uint8:
        shown = _scaled_to_bytes(shown)
    if shown.ndim == 3 and shown.shape[2] == 1:
        shown = shown[:, :, 0]
    return _encode(np.ascontiguousarray(shown))


def _scaled_to_bytes(values: Any) -> Any:
    import numpy as np

    numbers = np.nan_to_num(values.astype(np.float64), posinf=0.0, neginf=0.0)
    least, greatest = float(numbers.min()), float(numbers.max())
    return ((numbers - least) * (255.0 / ((greatest - least) or 1.0))).astype(np.uint8)


def _encode(pixels: Any) -> bytes:
    height, width = pixels.shape[:2]
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    header = struct.pack(">IIBBBBB", width, height, 8, _COLOUR_TYPES[channels], 0, 0, 0)
    rows = b"".join(b"\0" + pixels[row].tobytes() for row in range(height))
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(rows, 1)) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
