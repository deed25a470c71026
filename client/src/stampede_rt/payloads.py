"""What callers put into items, checked. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt.errors import InvalidArgument


def check_payload(payload: object) -> bytes:
    """`payload` as bytes; anything with a buffer will do. Text is refused, since its encoding would be a guess."""
    if type(payload) is bytes:
        return payload
    if isinstance(payload, bytes | bytearray | memoryview):
        return bytes(payload)
    raise InvalidArgument(f"the payload is a {type(payload).__name__}; give bytes, such as text.encode()")


def check_attributes(attributes: Mapping[str, str] | None) -> None:
    """Raises InvalidArgument unless all keys and values are text."""
    if attributes is None:
        return
    if isinstance(attributes, Mapping) and all(
        isinstance(key, str) and isinstance(value, str) for key, value in attributes.items()
    ):
        return
    raise InvalidArgument(f"the attributes are {attributes!r}; give a mapping of text to text")
