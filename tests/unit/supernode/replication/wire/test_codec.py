"""The codec refuses malformed messages, and decodes the messages that it encoded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.settings import COMMAND_BYTES_MAX
from stampede_rt_supernode.replication.wire.codec import decode_message, encode_message
from stampede_rt_supernode.replication.wire.messages import (
    AppendReply,
    ForwardedCommand,
    ForwardedCommandReply,
    ForwardRefusal,
    InstallSnapshot,
    Message,
    ReadIndexReply,
    ReadIndexRequest,
    SnapshotChunk,
    TimeoutNow,
    VoteReply,
    VoteRequest,
)
from stampede_rt_supernode.replication.wire.records import (
    MalformedMessage,
    SnapshotContents,
    check_command,
    decode_configuration,
    decode_snapshot,
    encode_configuration,
    encode_entry,
    encode_snapshot,
)
from tests.support.supernode.lone_node import acknowledgement, append, vote

CHUNK = SnapshotChunk(last_log_index=9, offset_bytes=2, total_bytes=7, sha256=bytes(32), data=b"part")

EVERY_KIND: list[Message] = [
    append(3, (7, 2), [(8, 2), (9, 3)], commit=8),
    replace(append(3, (7, 2), [], commit=8), round=5, digest=(8, b"digest"), majority_digest=(7, b"most")),
    InstallSnapshot(term=3, commit_index=8, round=4, chunk=None),
    AppendReply(term=3, next_index=8, reset=False, success=True, round=5, digest=(7, b"digest")),
    InstallSnapshot(term=3, commit_index=8, round=4, chunk=CHUNK, digest=(8, b"digest"), majority_digest=(7, b"most")),
    acknowledgement(3, 9),
    VoteRequest(term=4, last_log_index=9, last_log_term=3),
    vote(4),
    VoteReply(term=4, pre_vote=True, voter_term=3),
    TimeoutNow(term=4),
    ForwardedCommand(request_id=77, command=b"\x00payload"),
    ForwardedCommandReply(request_id=77, log_index=10, log_term=4),
    *(ForwardedCommandReply(request_id=77, refusal=refusal) for refusal in ForwardRefusal),
    ReadIndexRequest(request_id=5),
    ReadIndexReply(request_id=5, read_index=10),
]

MEMBERS = Configuration.of([Member(member_id="b", address="b:1"), Member(member_id="a", address="a:1")], retired=["c"])


@pytest.mark.parametrize("message", EVERY_KIND, ids=lambda message: type(message).__name__)
def test_every_kind_of_message_is_decoded_as_it_was_encoded(message: Message) -> None:
    wire = encode_message(message).SerializeToString()
    assert decode_message(pb.RaftMessage.FromString(wire)) == message


def test_the_examples_contain_every_kind_of_message() -> None:
    assert {type(message) for message in EVERY_KIND} == set(get_args(Message))


def entry(index: int, term: int = 1, command: bytes = b"\x00") -> pb.RaftLogEntry:
    return pb.RaftLogEntry(log_index=index, term=term, command=command)


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("append_entries", pb.RaftAppendEntries(term=1, previous_log_index=1, entries=[entry(3)])),
        ("append_entries", pb.RaftAppendEntries(term=1, previous_log_index=1, entries=[entry(2, term=2)])),
        ("append_entries", pb.RaftAppendEntries(term=1, previous_log_index=1, entries=[entry(2, command=b"")])),
        ("append_entries", pb.RaftAppendEntries(term=1, previous_log_index=1, entries=[entry(2, command=b"\x02")])),
        ("append_entries", pb.RaftAppendEntries(term=2**63)),
        ("append_entries", pb.RaftAppendEntries(installing_snapshot=True, chunk=pb.RaftSnapshotChunk(data=b"x"))),
        ("append_reply", pb.RaftAppendReply(term=1)),
        ("forwarded_command", pb.RaftForwardedCommand(command=b"\x01")),
        ("forwarded_command", pb.RaftForwardedCommand(command=b"\x00" * (COMMAND_BYTES_MAX + 2))),
        ("forwarded_command_reply", pb.RaftForwardedCommandReply(refusal=99)),  # type: ignore[arg-type]
    ],
)
def test_a_malformed_message_is_refused(kind: str, body: Any) -> None:
    with pytest.raises(MalformedMessage):
        decode_message(pb.RaftMessage(**{kind: body}))


def test_a_message_without_a_kind_is_refused() -> None:
    with pytest.raises(MalformedMessage, match="no known kind"):
        decode_message(pb.RaftMessage())


@given(st.binary(max_size=200))
def test_random_bytes_are_refused_or_well_formed(data: bytes) -> None:
    is_well_formed(data)


@pytest.mark.parametrize("message", EVERY_KIND, ids=lambda message: type(message).__name__)
def test_a_damaged_message_is_refused_or_well_formed(message: Message) -> None:
    wire = encode_message(message).SerializeToString()
    well_formed = 0
    for at in range(len(wire)):
        for bit in range(8):
            well_formed += is_well_formed(wire[:at] + bytes((wire[at] ^ 1 << bit,)) + wire[at + 1 :])
    assert well_formed


def is_well_formed(data: bytes) -> bool:
    """Whether the bytes are a message. Checks that the encoded message is decoded as the same message."""
    try:
        message = decode_message(pb.RaftMessage.FromString(data))
    except (DecodeError, MalformedMessage):
        return False
    assert decode_message(encode_message(message)) == message
    return True


def test_a_snapshot_is_decoded_as_it_was_encoded() -> None:
    previous, last = Entry(b"\x00a", 4, 1), Entry(b"\x01", 5, 2)
    record = encode_snapshot(previous=previous, last=last, configuration=MEMBERS, state=b"state")
    assert decode_snapshot(record) == SnapshotContents(
        previous=previous, last=last, configuration=MEMBERS, state=b"state"
    )


def test_a_snapshot_of_a_release_without_membership_changes_has_no_configuration() -> None:
    old = pb.RaftSnapshot(
        previous=encode_entry(Entry(b"\x00", 4, 1)), last=encode_entry(Entry(b"\x00", 5, 1)), member_ids=["a"]
    )
    assert decode_snapshot(old.SerializeToString()).configuration is None


def test_a_configuration_is_decoded_as_it_was_encoded() -> None:
    assert decode_configuration(encode_configuration(MEMBERS)) == MEMBERS


@pytest.mark.parametrize(
    "broken",
    [
        pb.RaftConfiguration(),
        pb.RaftConfiguration(members=[pb.RaftMember(member_id="a", address="")]),
        pb.RaftConfiguration(members=[pb.RaftMember(member_id="a", address="a:1")] * 2),
        pb.RaftConfiguration(members=[pb.RaftMember(member_id="a", address="a:1")], retired_ids=["a"]),
    ],
)
def test_an_impossible_configuration_is_refused(broken: pb.RaftConfiguration) -> None:
    with pytest.raises(MalformedMessage):
        check_command(b"\x02" + broken.SerializeToString())


def test_a_snapshot_whose_last_entries_are_not_consecutive_is_refused() -> None:
    record = encode_snapshot(previous=Entry(b"\x00", 3, 1), last=Entry(b"\x00", 5, 2), configuration=MEMBERS, state=b"")
    with pytest.raises(MalformedMessage, match="neighbours"):
        decode_snapshot(record)


@given(st.binary(max_size=100))
def test_a_random_snapshot_is_refused(record: bytes) -> None:
    with pytest.raises(MalformedMessage):
        decode_snapshot(record)
