"""The library's messages become ours, and back, with nothing lost."""

from __future__ import annotations

import pytest

from stampede_rt_supernode.replication.library.translation import from_library, to_library
from stampede_rt_supernode.replication.wire.messages import (
    AppendEntries,
    AppendReply,
    ForwardedCommand,
    ForwardedCommandReply,
    ForwardRefusal,
    Message,
    ReadIndexRequest,
    VoteReply,
    VoteRequest,
)

BOTH_WAYS: list[Message] = [
    AppendEntries(term=3, commit_index=2, previous_index=1, previous_term=0, entries=[]),
    AppendReply(term=0, next_index=9, reset=True, success=False),
    VoteRequest(term=4, last_log_index=9, last_log_term=3),
    VoteReply(term=4),
    ForwardedCommand(request_id=7, command=b"\x00c"),
    ForwardedCommandReply(request_id=7, log_index=9, log_term=4),
    *(ForwardedCommandReply(request_id=7, refusal=refusal) for refusal in ForwardRefusal),
]


@pytest.mark.parametrize("message", BOTH_WAYS, ids=lambda message: type(message).__name__)
def test_a_message_is_decoded_as_it_was_encoded(message: Message) -> None:
    assert from_library(to_library(message)) == message


def test_a_message_of_a_kind_that_is_never_sent_is_not_passed_on() -> None:
    with pytest.raises(KeyError):
        from_library({"type": "set_version", "version": 1})


def test_a_foreign_message_is_not_passed_to_the_library() -> None:
    with pytest.raises(KeyError):
        to_library(ReadIndexRequest(request_id=1))
