"""Checks of the payloads and attributes that callers give. This module does no I/O."""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt.errors import InvalidArgument, ItemTooLarge

ITEM_BYTES_MAX = 16 * 1024 * 1024
ATTRIBUTES_BYTES_MAX = 16 * 1024


def check_payload(payload: object) -> bytes:
    """Return `payload` as bytes. Takes bytes, bytearray and memoryview; other values need a codec.

    Raises InvalidArgument, ItemTooLarge.
    """
    data = payload if type(payload) is bytes else _copied(payload)
    if len(data) > ITEM_BYTES_MAX:
        raise ItemTooLarge(
            f"the payload has {len(data)} bytes; one item or message has at most {ITEM_BYTES_MAX}: split it"
        )
    return data


def _copied(payload: object) -> bytes:
    if not isinstance(payload, bytes | bytearray | memoryview):
        raise InvalidArgument(f"the payload is a {type(payload).__name__}; {_advice(payload)}")
    return bytes(payload)


def _advice(payload: object) -> str:
    """Return the part of an error text that says what to give instead of `payload`."""
    if isinstance(payload, str):
        return 'give text.encode(), or open the channel or queue with codec="json"'
    if hasattr(payload, "__array_interface__"):
        return 'open the channel or queue with codec="numpy", or give payload.tobytes()'
    return 'give bytes, or open the channel or queue with a codec: codec="json", codec="numpy" or one of your own'


def check_attributes(attributes: Mapping[str, str] | None) -> None:
    """Raise InvalidArgument unless all keys and values are text."""
    if attributes is None:
        return
    if isinstance(attributes, Mapping) and all(
        text_length_bytes(part) is not None for pair in attributes.items() for part in pair
    ):
        return
    raise InvalidArgument(f"the attributes are {attributes!r}; give a mapping of text to text")


def copied_attributes(attributes: Mapping[str, str] | None) -> dict[str, str] | None:
    """Return a copy, because the caller may change its mapping after the call; None if there are no attributes.

    Reads the mapping once. Raises InvalidArgument unless the copy has only text, and at most ATTRIBUTES_BYTES_MAX.
    """
    if attributes is None:
        return None
    if not isinstance(attributes, Mapping):
        check_attributes(attributes)  # raises
    copy = dict(attributes)
    check_attributes(copy)
    length_bytes = sum(len(key.encode()) + len(value.encode()) for key, value in copy.items())
    if length_bytes > ATTRIBUTES_BYTES_MAX:
        raise InvalidArgument(
            f"the attributes have {length_bytes} bytes in all; one item has at most {ATTRIBUTES_BYTES_MAX}: put large "
            "data into the payload"
        )
    return copy or None


def text_length_bytes(value: object) -> int | None:
    """Return the length of a text in bytes; None for other values, and for text that UTF-8 cannot encode."""
    if not isinstance(value, str):
        return None
    try:
        return len(value.encode())
    except UnicodeEncodeError:  # one half of a surrogate pair
        return None
