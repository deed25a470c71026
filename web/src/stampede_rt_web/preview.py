"""The preview of an item's payload: a picture, a wave form, a plot, text or bytes. Pure.

Payloads come from any producers, so this module expects every payload to be malformed or hostile. Each preview has a
bound in bytes. A picture has a content type of PICTURE_TYPES, and is never SVG, which could contain a script.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

from stampede_rt.values.codecs import NumpyCodec
from stampede_rt_web.picture_size import PIXELS_MAX, pixels_of
from stampede_rt_web.png import png_of

PICTURE_TYPES = {"image/jpeg": b"\xff\xd8\xff", "image/png": b"\x89PNG\r\n\x1a\n"}
"""The content types of pictures, and the first bytes of their payloads."""
DECODED_BYTES_MAX = 4 * 1024 * 1024  # a larger array or JSON text is shown as bytes
TEXT_CHARACTERS_MAX = 2000
HEX_BYTES_MAX = 256  # the bytes of a payload that the preview shows in hexadecimal
POINTS_MAX = 512  # the most points of a plot or wave form
NUMBERS_MAX = 8  # the most numbers of a JSON object
_RATE = re.compile(r"rate=(\d{1,7})")


def picture_of(content_type: str, payload: bytes) -> tuple[str, bytes] | None:
    """Return the content type and the bytes of a picture that a browser can show; None for other payloads."""
    kind = _kind(content_type)
    if _is_picture(kind, payload):
        return (kind, payload) if 0 < (pixels_of(payload) or 0) <= PIXELS_MAX else None
    if kind == NumpyCodec.content_type and len(payload) <= DECODED_BYTES_MAX:
        array = _array(payload)
        png = None if array is None else png_of(array)
        return None if png is None else ("image/png", png)
    return None


def preview_of(content_type: str, payload: bytes) -> dict[str, Any]:
    """Return the preview of a payload as JSON values. `kind` is picture, wave, plot, json, text or hex."""
    kind = _kind(content_type)
    if picture_of(content_type, payload) is not None:
        return {"kind": "picture", **(_array_facts(payload) if kind == NumpyCodec.content_type else {})}
    if _is_picture(kind, payload) and (pixels := pixels_of(payload) or 0) > PIXELS_MAX:
        return {"kind": "text", "text": f"A picture of {pixels:,} pixels is too large for this page."}
    if len(payload) <= DECODED_BYTES_MAX:
        if kind == NumpyCodec.content_type:
            shown = _plot(payload)
        elif kind == "audio/pcm" and "format=s16le" in content_type:
            shown = _wave(content_type, payload)
        elif kind == "application/json" or kind.endswith("+json"):
            shown = _json(payload)
        else:
            shown = None
        if shown is not None:
            return shown
    return _text(kind, payload) or {"kind": "hex", "text": hex_lines(payload[:HEX_BYTES_MAX])}


def hex_lines(payload: bytes) -> str:
    """Return bytes as lines of 16: their offset, their hexadecimal digits, and their ASCII characters."""
    lines = []
    for start in range(0, len(payload), 16):
        row = payload[start : start + 16]
        letters = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in row)
        lines.append(f"{start:04x}  {row.hex(' '):<47}  {letters}")
    return "\n".join(lines)


def numbers_in(value: Any) -> dict[str, float]:
    """Return the finite numbers of a JSON object by their names. A JSON number by itself has the name "value"."""
    if isinstance(value, dict):
        named = {name: one for name, one in value.items() if _is_number(one)}
        return {str(name)[:64]: float(one) for name, one in list(named.items())[:NUMBERS_MAX]}
    return {"value": float(value)} if _is_number(value) else {}


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _kind(content_type: str) -> str:
    return content_type.split(";", 1)[0].strip().lower()


def _is_picture(kind: str, payload: bytes) -> bool:
    return kind in PICTURE_TYPES and payload.startswith(PICTURE_TYPES[kind])


def _array(payload: bytes) -> Any:
    try:
        return NumpyCodec().decode(payload)
    except Exception:  # noqa: BLE001  # numpy raises many kinds for a payload that is not an array
        return None


def _array_facts(payload: bytes) -> dict[str, Any]:
    array = _array(payload)
    return {"shape": list(array.shape), "dtype": str(array.dtype)}


def _plot(payload: bytes) -> dict[str, Any] | None:
    array = _array(payload)
    if array is None or array.dtype.kind not in "biuf":
        return None
    flat = array.reshape(-1)
    step = max(1, -(-len(flat) // POINTS_MAX))
    values = [float(value) if math.isfinite(value) else None for value in flat[::step]]
    return {"kind": "plot", "values": values, "step": step, "shape": list(array.shape), "dtype": str(array.dtype)}


def _wave(content_type: str, payload: bytes) -> dict[str, Any]:
    """Divide the samples into at most POINTS_MAX parts, and return the least and the greatest sample of each part.

    Samples are from -1 to 1.
    """
    import numpy as np

    samples = np.frombuffer(payload[: len(payload) // 2 * 2], dtype="<i2")
    stretches = np.array_split(samples, min(POINTS_MAX, len(samples))) if len(samples) else []
    wave = [[int(one.min()) / 32768, int(one.max()) / 32768] for one in stretches]
    rate = _RATE.search(content_type)
    return {"kind": "wave", "wave": wave, "samples": len(samples), "rate_hz": int(rate[1]) if rate else None}


def _json(payload: bytes) -> dict[str, Any] | None:
    try:
        value = json.loads(payload)
        text = _indented(value)
    except (ValueError, RecursionError):
        return None
    return {"kind": "json", "text": _cut(text), "numbers": numbers_in(value)}


def _indented(value: Any) -> str:
    """Return the beginning of a JSON text with indents, which may be hundreds of times as long as the payload."""
    text = ""
    for piece in json.JSONEncoder(indent=1, ensure_ascii=False).iterencode(value):
        text += piece
        if len(text) > TEXT_CHARACTERS_MAX:
            break
    return text


def _text(kind: str, payload: bytes) -> dict[str, Any] | None:
    try:
        text = payload[: 4 * TEXT_CHARACTERS_MAX].decode()
    except UnicodeDecodeError as error:
        if error.start < 4 * TEXT_CHARACTERS_MAX - 4:
            return None
        text = payload[: error.start].decode()
    is_readable = text.isprintable() or all(one.isprintable() or one in "\n\r\t" for one in text)
    return {"kind": "text", "text": _cut(text)} if is_readable or kind.startswith("text/") else None


def _cut(text: str) -> str:
    return text if len(text) <= TEXT_CHARACTERS_MAX else text[:TEXT_CHARACTERS_MAX] + "…"
