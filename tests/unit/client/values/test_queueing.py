"""What callers give to queues: text that cannot be sent is refused with a sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.queueing import parse_message_id, parse_reason

LONE_SURROGATE = "\ud800"


@pytest.mark.parametrize(("parse", "name"), [(parse_message_id, "message_id"), (parse_reason, "reason")])
@pytest.mark.parametrize("value", [LONE_SURROGATE, "x" * 100_000, 5, b"bytes"])
def test_what_is_no_text_or_too_long_is_refused_in_few_words(
    parse: Callable[[Any], str], name: str, value: Any
) -> None:
    with pytest.raises(InvalidArgument, match=f"{name} is") as caught:
        parse(value)
    assert len(caught.value.message) < 400


def test_none_stands_for_no_text() -> None:
    assert (parse_message_id(None), parse_reason(None)) == ("", "")
