"""Payloads as text for people."""

from __future__ import annotations

import pytest

from stampede_rt.cli.payload_text import VALUE_CHARACTERS_MAX, preview
from stampede_rt.values.codecs import NumpyCodec


def shown(payload: bytes, content_type: str) -> str:
    return preview(payload, len(payload), content_type)


def test_json_is_shown_by_its_value() -> None:
    assert shown(b'{\n  "a": [1,\n 2]}', "application/json; charset=utf-8") == '{"a": [1, 2]}'
    assert shown(b'"\\u001b[31m"', "application/geo+json") == '"\\u001b[31m"'


@pytest.mark.parametrize("payload", [b"{", b"[" * 100_000, b"1" * 6000])
def test_a_payload_that_is_no_json_is_shown_as_text(payload: bytes) -> None:
    assert shown(payload, "application/json").startswith(payload[:1].decode())


def test_an_array_is_shown_by_type_shape_range_and_first_values() -> None:
    np = pytest.importorskip("numpy")
    kind = "application/x-npy"
    assert shown(NumpyCodec().encode(np.array([[1.5, 2], [3, 4]])), kind) == "float64 2x2 from 1.5 to 4: [1.5, 2, 3, 4]"
    assert shown(NumpyCodec().encode(np.array(7)), kind) == "int64 scalar: [7]"
    assert shown(NumpyCodec().encode(np.zeros((0, 3))), kind) == "float64 0x3: []"
    assert shown(NumpyCodec().encode(np.array(["\x1b]0;t\x07" * 99])), kind).isprintable()


def test_a_damaged_array_is_shown_by_its_length() -> None:
    assert shown(b"\x93NUMPY\xff", "application/x-npy") == "[7 bytes application/x-npy]"


def test_a_long_value_is_cut() -> None:
    text = shown(b"[" + b"1," * 999 + b"1]", "application/json")
    assert len(text) < VALUE_CHARACTERS_MAX + 30
    assert text.endswith("... [3000 characters]")
