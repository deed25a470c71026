"""Numbers and lengths in protobuf's form. Pure."""

from __future__ import annotations

_SHORT = tuple(bytes((value,)) for value in range(0x80))


def encode_varint(value: int) -> bytes:
    """Return `value`, 0 or more, in protobuf's form of numbers and lengths."""
    if value < 0x80:
        return _SHORT[value]
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def decode_varint(raw: bytes | bytearray | memoryview, at: int) -> tuple[int, int]:
    """Return the number at position `at` in protobuf's form, and the position after it.

    Raises IndexError if the bytes end within the number, or if it is longer than protobuf allows.
    """
    value = 0
    for shift in range(0, 70, 7):
        byte = raw[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise IndexError("a number of more than 10 bytes")
