"""Parsers of the replicated log: messages between members, entries, commands, snapshots."""

from __future__ import annotations

from google.protobuf.message import DecodeError

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_command_pb2 as command_pb
from stampede_rt.v1 import raft_service_pb2 as raft_pb
from stampede_rt_supernode.codecs.command_codec import decode_command, encode_command
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReleaseTooOld
from stampede_rt_supernode.replication.wire.codec import decode_message, encode_message
from stampede_rt_supernode.replication.wire.records import (
    MalformedMessage,
    decode_configuration,
    decode_entry,
    decode_snapshot,
    encode_configuration,
)
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.messages import KnownValues, drawn_request
from tests.robustness.fuzz.parsers.target import Target

NAMES = ("a", "b", "cam/1", "h1", "s1", "s2")
KNOWN = KnownValues()
for field_name in ("name", "host_name", "name_glob", "member_id", "supernode_id"):
    KNOWN.add(field_name, *NAMES)
for field_name in ("channel_id", "host_id", "queue_id", "peer_id", "group_id", "op_id", "incarnation"):
    KNOWN.add(field_name, *(bytes([number]) * 16 for number in range(1, 5)))
KNOWN.add("epoch", 1, 2)
KNOWN.add("boot_incarnation", 1, 2)
KNOWN.add("target", "localhost:1", "localhost:2")
KNOWN.add("command", b"\0x", b"\1", b"\2")
KNOWN.add("log_index", 1, 2, 3)
COMMANDS = 8


def raft_message(source: ByteSource) -> None:
    raw = drawn_request(source, raft_pb.RaftMessage.DESCRIPTOR, KNOWN)
    message = decode_message(raft_pb.RaftMessage.FromString(raw))
    assert decode_message(encode_message(message)) == message


def raft_records(source: ByteSource) -> None:
    decode_entry(raft_pb.RaftLogEntry.FromString(drawn_request(source, raft_pb.RaftLogEntry.DESCRIPTOR, KNOWN)))
    raw = drawn_request(source, raft_pb.RaftConfiguration.DESCRIPTOR, KNOWN)
    configuration = decode_configuration(b"\2" + raw)
    assert decode_configuration(encode_configuration(configuration)) == configuration


def raft_snapshot(source: ByteSource) -> None:
    decode_snapshot(drawn_request(source, raft_pb.RaftSnapshot.DESCRIPTOR, KNOWN))


def command(source: ByteSource) -> None:
    decoded = decode_command(drawn_request(source, command_pb.DirectoryCommand.DESCRIPTOR, KNOWN))
    redecoded = decode_command(encode_command(decoded))
    assert repr(redecoded) == repr(decoded)  # a comparison of values would fail for NaN


def directory(source: ByteSource) -> None:
    """Check that two replicas give equal answers to any commands, and that a third one with the snapshot is equal."""
    one, other = DirectoryReplica(), DirectoryReplica()
    for index in range(1, COMMANDS + 1):
        raw = drawn_request(source, command_pb.DirectoryCommand.DESCRIPTOR, KNOWN)
        assert one.apply(index, raw) == other.apply(index, raw)
    snapshot = one.begin_snapshot()()
    third = DirectoryReplica()
    third.prepare_restore(snapshot)()
    assert third.begin_snapshot()() == snapshot


def directory_snapshot(source: ByteSource) -> None:
    """Check that only valid snapshots are accepted, and that an accepted one can be written again."""
    replica = DirectoryReplica()
    replica.prepare_restore(drawn_request(source, command_pb.DirectorySnapshot.DESCRIPTOR, KNOWN))()
    replica.begin_snapshot()()


REFUSED = (MalformedMessage, DecodeError)
TARGETS = (
    Target("raft_message", raft_message, REFUSED),
    Target("raft_records", raft_records, REFUSED),
    Target("raft_snapshot", raft_snapshot, REFUSED),
    Target("command", command, (StampedeError,)),
    Target("directory", directory, (ReleaseTooOld,)),
    Target("directory_snapshot", directory_snapshot, (StampedeError, ReleaseTooOld)),
)
