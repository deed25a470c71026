"""Protobuf's varints: the form of numbers and lengths. Pure."""

from __future__ import annotations

_SHORT = tuple(bytes((value,)) for value in range(0x80))


def encode_varint(value: int) -> bytes:
    """Return `value`, 0 or more, as a varint."""
    if value < 0x80:
        return _SHORT[value]
    if value < 0x4000:
        return bytes((value & 0x7F | 0x80, value >> 7))
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def decode_varint(raw: bytes | bytearray | memoryview, at: int) -> tuple[int, int]:
    """Return the number whose varint is at position `at`, and the position after the varint.

    Raises IndexError if the bytes end within the varint, or if the varint is longer than protobuf allows.
    """
    value = 0
    for shift in range(0, 70, 7):
        byte = raw[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise IndexError("a number of more than 10 bytes")
