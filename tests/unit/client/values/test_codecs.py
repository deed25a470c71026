"""Codecs without a network: missing packages, and values between processes."""

from __future__ import annotations

import pickle
import subprocess
import sys

import pytest

from stampede_rt.errors import CodecError, InvalidArgument
from stampede_rt.values.codecs import Codec, CodedItem, HandleCodec, JsonCodec
from stampede_rt.values.model import Item

FIELDS = (5, None, None, 1, b"[1]", {}, "application/json", 3, 9)


def coding() -> HandleCodec:
    made = HandleCodec.parse("json", "channel 'x'")
    assert made is not None
    return made


def test_without_numpy_the_error_of_its_codec_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(CodecError, match="pip install numpy"):
        HandleCodec.parse("numpy", "channel 'x'")


def test_importing_the_client_imports_no_numpy() -> None:
    code = "import sys, stampede_rt; print('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_an_item_with_a_codec_equals_the_same_item_without() -> None:
    assert coding().item(FIELDS) == Item._make(FIELDS)


def test_an_item_with_a_codec_can_be_sent_to_another_process() -> None:
    copy = pickle.loads(pickle.dumps(coding().item(FIELDS)))
    assert (copy.value, copy) == ([1], Item._make(FIELDS))


def test_a_copy_of_an_item_has_its_payload_as_value() -> None:
    copy = coding().item(FIELDS)._replace(seq=2)
    assert isinstance(copy, CodedItem)
    assert copy.value == b"[1]"


def test_a_content_type_with_parameters_is_the_same_type() -> None:
    assert coding().decode(b"[1]", "Application/JSON; charset=utf-8", "item") == [1]


def test_a_codec_needs_a_valid_content_type() -> None:
    class Odd(JsonCodec):
        content_type = ""

    assert isinstance(Odd(), Codec)
    with pytest.raises(InvalidArgument, match="content_type"):
        HandleCodec.parse(Odd(), "channel 'x'")
