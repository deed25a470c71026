"""Protobuf's varints: one function writes them, and the other one reads them."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies

from stampede_rt.wire.varints import decode_varint, encode_varint


@given(strategies.integers(0, 2**64 - 1), strategies.binary(max_size=3))
def test_a_decoded_number_is_as_it_was_encoded(value: int, before: bytes) -> None:
    encoded = encode_varint(value)
    assert decode_varint(before + encoded + b"rest", len(before)) == (value, len(before) + len(encoded))


def test_numbers_that_are_cut_or_too_long_raise() -> None:
    for raw in (b"", b"\x80", b"\x80" * 10 + b"\x01"):
        with pytest.raises(IndexError):
            decode_varint(raw, 0)
