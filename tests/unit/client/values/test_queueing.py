"""The arguments of callers of queues: text that cannot be sent is refused with a sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.policy import parse_policy
from stampede_rt.values.queueing import parse_message_id, parse_queue_policy, parse_reason

LONE_SURROGATE = "\ud800"


@pytest.mark.parametrize(("parse", "name"), [(parse_message_id, "message_id"), (parse_reason, "reason")])
@pytest.mark.parametrize("value", [LONE_SURROGATE, "x" * 100_000, 5, b"bytes"])
def test_ids_that_are_no_text_or_too_long_are_refused_in_few_words(
    parse: Callable[[Any], str], name: str, value: Any
) -> None:
    with pytest.raises(InvalidArgument, match=f"{name} is") as caught:
        parse(value)
    assert len(caught.value.message) < 400


def test_none_as_an_id_or_a_reason_becomes_an_empty_text() -> None:
    assert (parse_message_id(None), parse_reason(None)) == ("", "")


@pytest.mark.parametrize("parse", [parse_policy, parse_queue_policy])
def test_a_bound_of_bytes_that_admits_no_message_is_refused_immediately(parse: Callable[..., Any]) -> None:
    assert parse(max_bytes=64).max_bytes == 64
    for value in (1, 63):
        with pytest.raises(InvalidArgument, match=f"max_bytes is {value}; it must be 64 or more"):
            parse(max_bytes=value)
