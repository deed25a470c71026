"""Fields of protobuf messages in fixed places, so that both sides use `struct`. Protobuf would take longer."""

from __future__ import annotations

import struct

from stampede_rt.wire.varints import decode_varint, encode_varint

_WIRE_TYPES = {"Q": 1, "q": 1, "I": 5, "B": 0}


class FixedFields:
    """Numbers of a message, in the order of their field numbers. A message has all of them, also zeros."""

    def __init__(self, form: str, first: int = 1) -> None:
        """`form`: the kind of each field, as in `struct`: Q for fixed64, q for sfixed64, I for fixed32, B for bool.

        `first`: the number of the first field. All numbers are below 16.
        """
        self._struct = struct.Struct("<" + "".join(f"B{kind}" for kind in form))
        self._tags = tuple(number << 3 | _WIRE_TYPES[kind] for number, kind in enumerate(form, first))
        self._fields = tuple(one for tag in self._tags for one in (tag, 0))
        self.first_tag = self._tags[0]
        self.size_bytes = self._struct.size

    def encode(self, *values: int) -> bytes:
        """The encoded fields."""
        fields = [*self._fields]
        fields[1::2] = values
        return self._struct.pack(*fields)

    def read(self, raw: bytes | memoryview, at: int = 0) -> tuple[int, ...] | None:
        """The values of the fields from the position `at` on; None if other fields are there.

        Raises struct.error if the bytes end within a field.
        """
        found = self._struct.unpack_from(raw, at)
        return found[1::2] if found[::2] == self._tags else None

    def read_whole(self, raw: bytes | memoryview) -> tuple[int, ...] | None:
        """Read a message that has only these fields. None for all other messages."""
        return self.read(raw) if len(raw) == self.size_bytes and raw[0] == self.first_tag else None


class LongField:
    """A field of bytes, text or a message. Its number is below 16."""

    def __init__(self, number: int) -> None:
        self.tag = number << 3 | 2
        self._tag_bytes = bytes((self.tag,))

    def head(self, length: int) -> bytes:
        """The encoded bytes before a value of this length."""
        return self._tag_bytes + encode_varint(length)

    def encode(self, *parts: bytes) -> bytes:
        """The encoded field with a value of several parts."""
        return b"".join((self.head(sum(map(len, parts))), *parts))

    def find(self, raw: bytes | memoryview, at: int = 0) -> tuple[int, int] | None:
        """The begin and the end of the value, if this field is at the position `at`; None if another field is there.

        The value may be longer than the bytes. Raises IndexError if the bytes end before it.
        """
        if raw[at] != self.tag:
            return None
        length, begin = decode_varint(raw, at + 1)
        return begin, begin + length
