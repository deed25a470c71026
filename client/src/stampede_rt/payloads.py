"""What callers put into items, checked. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt.errors import InvalidArgument, ItemTooLarge

ITEM_BYTES_MAX = 16 * 1024 * 1024


def check_payload(payload: object) -> bytes:
    """`payload` as bytes; anything with a buffer will do. Text is refused, since its encoding would be a guess.

    Raises InvalidArgument, ItemTooLarge.
    """
    if not isinstance(payload, bytes | bytearray | memoryview):
        raise InvalidArgument(f"the payload is a {type(payload).__name__}; give bytes, such as text.encode()")
    data = payload if type(payload) is bytes else bytes(payload)
    if len(data) > ITEM_BYTES_MAX:
        raise ItemTooLarge(f"the item has {len(data)} bytes; one item has {ITEM_BYTES_MAX} at most: split it")
    return data


def check_attributes(attributes: Mapping[str, str] | None) -> None:
    """Raises InvalidArgument unless all keys and values are text."""
    if attributes is None:
        return
    if isinstance(attributes, Mapping) and all(
        isinstance(key, str) and isinstance(value, str) for key, value in attributes.items()
    ):
        return
    raise InvalidArgument(f"the attributes are {attributes!r}; give a mapping of text to text")
