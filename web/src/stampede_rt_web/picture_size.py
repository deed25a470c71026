"""Reads from the header of a PNG or JPEG how many pixels the picture has. Pure.

A browser needs four bytes of memory for each pixel, and a payload of a megabyte may have a billion pixels.
"""

from __future__ import annotations

import struct

PIXELS_MAX = 40_000_000  # 8K video has 33 million
_SEGMENTS_MAX = 1000  # before the frame of a JPEG
_PNG_SIZE = struct.Struct(">4sII")
_JPEG_FRAME = struct.Struct(">HBHH")
_JPEG_LENGTH = struct.Struct(">H")
_NO_FRAMES = {0xC4, 0xC8, 0xCC}


def pixels_of(payload: bytes) -> int | None:
    """Return the number of pixels of a PNG or JPEG; None if its header is damaged."""
    try:
        return _pixels_of_png(payload) if payload.startswith(b"\x89PNG") else _pixels_of_jpeg(payload)
    except (struct.error, IndexError):
        return None


def _pixels_of_png(payload: bytes) -> int | None:
    kind, width, height = _PNG_SIZE.unpack_from(payload, 12)
    return width * height if kind == b"IHDR" else None


def _pixels_of_jpeg(payload: bytes) -> int | None:
    at = 2
    for _ in range(_SEGMENTS_MAX):
        if payload[at] != 0xFF:
            return None
        marker = payload[at + 1]
        if marker == 0xFF:  # a byte of filling
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES:
            _, _, height, width = _JPEG_FRAME.unpack_from(payload, at + 2)
            return int(height * width)
        else:
            at += 2 + int(_JPEG_LENGTH.unpack_from(payload, at + 2)[0])
    return None
