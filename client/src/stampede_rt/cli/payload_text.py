"""Payloads as text for people: text, JSON and numpy arrays readably, other bytes by their length."""

from __future__ import annotations

import json

from stampede_rt.escaping import escaped

TEXT_CHARACTERS_MAX = 60  # the most characters of a text that a line shows
VALUE_CHARACTERS_MAX = 240  # the most characters of JSON or of an array that a line shows
PARSED_BYTES_MAX = 1024 * 1024  # a longer payload is not parsed for a line on the screen
ARRAY_VALUES_SHOWN = 8


def preview(payload: bytes | None, length_bytes: int, content_type: str) -> str:
    """Return a payload for people, as one line without control characters.

    The line shows the values of JSON and numpy arrays, the beginning of a text, and the length and content type of
    other bytes.
    """
    value = None if payload is None or length_bytes > PARSED_BYTES_MAX else _value_text(payload, content_type)
    if value is not None:
        return _cut(value, VALUE_CHARACTERS_MAX)
    text = None if payload is None else text_of(payload)
    if text is None or "\0" in text:
        return f"[{length_bytes} bytes{' ' + escaped(content_type) if content_type else ''}]"
    return _cut(text, TEXT_CHARACTERS_MAX)


def _value_text(payload: bytes, content_type: str) -> str | None:
    kind = content_type.partition(";")[0].strip().lower()
    if kind == "application/json" or kind.endswith("+json"):
        return _json_text(payload)
    return _array_text(payload) if kind == "application/x-npy" else None


def text_of(payload: bytes) -> str | None:
    """Return a payload as text; None if it is not UTF-8."""
    try:
        return payload.decode()
    except UnicodeDecodeError:
        return None


def _cut(text: str, characters_max: int) -> str:
    more = f"... [{len(text)} characters]" if len(text) > characters_max else ""
    return escaped(text[:characters_max]) + more


def _json_text(payload: bytes) -> str | None:
    """Return JSON on one line, without needless spaces in numbers and lists; None if the payload is no JSON."""
    try:
        return json.dumps(json.loads(payload), ensure_ascii=False)
    except (ValueError, RecursionError):
        return None


def _array_text(payload: bytes) -> str | None:
    """Return the type, shape, range and first values of an array; None if it is damaged, or numpy is not installed."""
    try:
        from stampede_rt.values.codecs import NumpyCodec

        array = NumpyCodec().decode(payload)
    except Exception:  # noqa: BLE001  # numpy raises many kinds for damaged bytes
        return None
    shape = "x".join(map(str, array.shape)) or "scalar"
    values = array.ravel()[:ARRAY_VALUES_SHOWN].tolist()
    more = ", ..." if array.size > ARRAY_VALUES_SHOWN else ""
    first = ", ".join(f"{value:.6g}" if isinstance(value, float) else str(value) for value in values)
    between = f" from {array.min():.6g} to {array.max():.6g}" if array.size > 1 and array.dtype.kind in "iuf" else ""
    return f"{array.dtype} {shape}{between}: [{first}{more}]"
