"""Between the library's message dictionaries and the closed wire format; nothing else crosses a port.

Decoding checks every number, size and kind: what it returns cannot make the library raise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import DecodeError

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.configuration import MEMBERS_MAX, RETIRED_MAX, Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import COMMAND, CONFIGURATION, NO_OP, Entry
from stampede_rt_supernode.replication.settings import COMMAND_BYTES_MAX, SNAPSHOT_PIECE_BYTES_MAX

Message = dict[str, Any]

# Twice as much fits the disk: whatever is counted on from here stays within it for ever.
INT_MAX = 2**62
MEMBER_ID_BYTES_MAX, ADDRESS_BYTES_MAX = 512, 512
SNAPSHOT_BYTES_MAX = 1 << 30
DIGEST_BYTES_MAX = 64


class MalformedMessage(ValueError):
    """A peer sent something that no member of this version sends."""


def _number(value: int) -> int:
    if value > INT_MAX:
        raise MalformedMessage(f"{value} is past 2^62")
    return value


def check_command(command: bytes) -> bytes:
    """Return a log command (kind byte and payload). Raises MalformedMessage."""
    if not command or command[0] not in (COMMAND, NO_OP, CONFIGURATION):
        raise MalformedMessage("a log entry is of no known kind")
    if command[0] == CONFIGURATION:
        decode_configuration(command)
    if len(command) > COMMAND_BYTES_MAX + 1:
        raise MalformedMessage(f"a command of {len(command) - 1} bytes is over the limit of {COMMAND_BYTES_MAX}")
    return command


def encode_members(members: Iterable[Member]) -> list[pb.RaftMember]:
    """Members as they travel."""
    return [pb.RaftMember(member_id=member.member_id, address=member.address) for member in members]


def decode_members(members: Iterable[pb.RaftMember]) -> list[Member]:
    """The members, checked. Raises MalformedMessage."""
    found = [Member(member_id=member.member_id, address=member.address) for member in members]
    if len({member.member_id for member in found}) != len(found) or len(found) > MEMBERS_MAX:
        raise MalformedMessage(f"{len(found)} members are too many, or one is named twice")
    if not all(0 < len(member.member_id.encode()) <= MEMBER_ID_BYTES_MAX for member in found):
        raise MalformedMessage("a member has no id, or one that is too long")
    if not all(0 < len(member.address.encode()) <= ADDRESS_BYTES_MAX for member in found):
        raise MalformedMessage("a member has no address, or one that is too long")
    return found


def encode_configuration(configuration: Configuration) -> bytes:
    """The log command that puts a configuration into force."""
    return bytes((CONFIGURATION,)) + _configuration_message(configuration).SerializeToString(deterministic=True)


def decode_configuration(command: bytes) -> Configuration:
    """The configuration in a log command of that kind. Raises MalformedMessage."""
    try:
        message = pb.RaftConfiguration.FromString(command[1:])
    except DecodeError as error:
        raise MalformedMessage(f"a configuration cannot be read: {error}") from error
    return _configuration(message)


def _configuration_message(configuration: Configuration) -> pb.RaftConfiguration:
    return pb.RaftConfiguration(
        members=encode_members(configuration.members),
        retired_ids=configuration.retired,
        spent_tickets=[
            pb.RaftSpentTicket(ticket_sha256=ticket, member_id=member_id) for ticket, member_id in configuration.spent
        ],
    )


def _configuration(message: pb.RaftConfiguration) -> Configuration:
    if not message.members or len(message.retired_ids) > RETIRED_MAX:
        raise MalformedMessage("a configuration has no member, or too many retired ones")
    members = decode_members(message.members)
    if not {member.member_id for member in members}.isdisjoint(message.retired_ids):
        raise MalformedMessage("a configuration names a member that was removed")
    spent = [(one.ticket_sha256, one.member_id) for one in message.spent_tickets]
    return Configuration.of(members, message.retired_ids, spent)


def encode_entry(entry: Entry) -> pb.RaftLogEntry:
    """An entry as it travels and rests in snapshots."""
    return pb.RaftLogEntry(log_index=entry[1], term=entry[2], command=entry[0])


def decode_entry(entry: pb.RaftLogEntry) -> Entry:
    """The entry, checked. Raises MalformedMessage."""
    if entry.log_index == 0:
        raise MalformedMessage("log positions start at 1")
    return Entry(check_command(entry.command), _number(entry.log_index), _number(entry.term))


def _encode_append(message: Message) -> pb.RaftMessage:
    body = pb.RaftAppendEntries(
        term=message["term"], commit_index=message["commit_index"], round=message.get("round", 0)
    )
    body.digest_index, body.digest = message.get("digest", (0, b""))
    if "serialized" in message:
        body.installing_snapshot = True
        if message["serialized"] is not None:
            body.chunk.CopyFrom(message["serialized"])
    else:
        body.previous_log_index = message["prevLogIdx"]
        body.previous_log_term = message["prevLogTerm"]
        body.entries.extend(encode_entry(entry) for entry in message["entries"])
    return pb.RaftMessage(append_entries=body)


def _decode_append(body: pb.RaftAppendEntries) -> Message:
    message: Message = {
        "type": "append_entries",
        "term": _number(body.term),
        "commit_index": _number(body.commit_index),
        "round": _number(body.round),
    }
    if body.digest:
        message["digest"] = _number(body.digest_index), body.digest[:DIGEST_BYTES_MAX]
    if body.installing_snapshot:
        message["serialized"] = _checked_chunk(body.chunk) if body.HasField("chunk") else None
        return message
    previous, term = _number(body.previous_log_index), _number(body.previous_log_term)
    entries = [decode_entry(entry) for entry in body.entries]
    message.update(prevLogIdx=previous, prevLogTerm=term, entries=entries)
    for offset, entry in enumerate(entries, start=1):
        if entry.log_index != previous + offset or not term <= entry.term <= body.term:
            raise MalformedMessage(f"entry {entry.log_index} does not belong after {previous} in term {body.term}")
        term = entry.term
    return message


def _checked_chunk(chunk: pb.RaftSnapshotChunk) -> pb.RaftSnapshotChunk:
    end = chunk.offset_bytes + len(chunk.data)
    if not 0 < chunk.total_bytes <= SNAPSHOT_BYTES_MAX or end > chunk.total_bytes:
        raise MalformedMessage(f"a snapshot piece ends at {end} of {chunk.total_bytes} bytes")
    if not 0 < len(chunk.data) <= SNAPSHOT_PIECE_BYTES_MAX or len(chunk.sha256) != 32:
        raise MalformedMessage("a snapshot piece is empty, too large or without checksum")
    _number(chunk.last_log_index)
    return chunk


def _encode_append_reply(message: Message) -> pb.RaftMessage:
    return pb.RaftMessage(
        append_reply=pb.RaftAppendReply(
            term=message.get("term", 0),
            round=message.get("round", 0),
            next_index=message["next_node_idx"],
            reset=message["reset"],
            success=message["success"],
        )
    )


def _decode_append_reply(body: pb.RaftAppendReply) -> Message:
    if body.next_index == 0:
        raise MalformedMessage("next_index is 0")
    return {
        "type": "next_node_idx",
        "term": _number(body.term),
        "round": _number(body.round),
        "next_node_idx": _number(body.next_index),
        "reset": body.reset,
        "success": body.success,
    }


def _encode_vote_request(message: Message) -> pb.RaftMessage:
    return pb.RaftMessage(
        vote_request=pb.RaftVoteRequest(
            term=message["term"],
            last_log_index=message["last_log_index"],
            last_log_term=message["last_log_term"],
            trial=message.get("trial", False),
        )
    )


def _decode_vote_request(body: pb.RaftVoteRequest) -> Message:
    return {
        "type": "request_vote",
        "term": _number(body.term),
        "last_log_index": _number(body.last_log_index),
        "last_log_term": _number(body.last_log_term),
        "trial": body.trial,
    }


def _encode_vote_reply(message: Message) -> pb.RaftMessage:
    body = pb.RaftVoteReply(
        term=message["term"], trial=message.get("trial", False), voter_term=message.get("voter_term", 0)
    )
    return pb.RaftMessage(vote_reply=body)


def _decode_vote_reply(body: pb.RaftVoteReply) -> Message:
    return {
        "type": "response_vote",
        "term": _number(body.term),
        "trial": body.trial,
        "voter_term": _number(body.voter_term),
    }


def _encode_command(message: Message) -> pb.RaftMessage:
    body = pb.RaftForwardedCommand(request_id=message["request_id"], command=message["command"])
    return pb.RaftMessage(forwarded_command=body)


def _decode_command(body: pb.RaftForwardedCommand) -> Message:
    command = check_command(body.command)
    if command[0] != COMMAND:
        raise MalformedMessage("only commands are forwarded")
    return {"type": "apply_command", "request_id": _number(body.request_id), "command": command}


def _encode_command_reply(message: Message) -> pb.RaftMessage:
    body = pb.RaftForwardedCommandReply(request_id=message["request_id"])
    if "error" in message:
        body.refusal = _REFUSAL_OF_REASON[message["error"]]
    else:
        body.log_index, body.log_term = message["log_idx"], message["log_term"]
    return pb.RaftMessage(forwarded_command_reply=body)


def _decode_command_reply(body: pb.RaftForwardedCommandReply) -> Message:
    message: Message = {"type": "apply_command_response", "request_id": _number(body.request_id)}
    if body.refusal == pb.RAFT_REFUSAL_UNSPECIFIED:
        message.update(log_idx=_number(body.log_index), log_term=_number(body.log_term))
    elif body.refusal in _REASON_OF_REFUSAL:
        message["error"] = _REASON_OF_REFUSAL[body.refusal]
    else:
        raise MalformedMessage(f"refusal {body.refusal} is not known")
    return message


# The library's FAIL_REASON numbers that a refusal can carry.
_REFUSAL_OF_REASON = {
    1: pb.RAFT_REFUSAL_QUEUE_FULL,
    2: pb.RAFT_REFUSAL_MISSING_LEADER,
    4: pb.RAFT_REFUSAL_NOT_LEADER,
}
_REASON_OF_REFUSAL = {refusal: reason for reason, refusal in _REFUSAL_OF_REASON.items()}


def _encode_read(message: Message) -> pb.RaftMessage:
    return pb.RaftMessage(read_index_request=pb.RaftReadIndexRequest(request_id=message["request_id"]))


def _decode_read(body: pb.RaftReadIndexRequest) -> Message:
    return {"type": "read_index", "request_id": _number(body.request_id)}


def _encode_read_reply(message: Message) -> pb.RaftMessage:
    body = pb.RaftReadIndexReply(request_id=message["request_id"], read_index=message["read_index"])
    return pb.RaftMessage(read_index_reply=body)


def _decode_read_reply(body: pb.RaftReadIndexReply) -> Message:
    return {
        "type": "read_index_response",
        "request_id": _number(body.request_id),
        "read_index": _number(body.read_index),
    }


def _encode_timeout_now(message: Message) -> pb.RaftMessage:
    return pb.RaftMessage(timeout_now=pb.RaftTimeoutNow(term=message["term"]))


def _decode_timeout_now(body: pb.RaftTimeoutNow) -> Message:
    return {"type": "timeout_now", "term": _number(body.term)}


_ENCODERS: dict[str, Callable[[Message], pb.RaftMessage]] = {
    "append_entries": _encode_append,
    "next_node_idx": _encode_append_reply,
    "request_vote": _encode_vote_request,
    "response_vote": _encode_vote_reply,
    "apply_command": _encode_command,
    "apply_command_response": _encode_command_reply,
    "read_index": _encode_read,
    "read_index_response": _encode_read_reply,
    "timeout_now": _encode_timeout_now,
}
_DECODERS: dict[str, Callable[[Any], Message]] = {
    "append_entries": _decode_append,
    "append_reply": _decode_append_reply,
    "vote_request": _decode_vote_request,
    "vote_reply": _decode_vote_reply,
    "forwarded_command": _decode_command,
    "forwarded_command_reply": _decode_command_reply,
    "read_index_request": _decode_read,
    "read_index_reply": _decode_read_reply,
    "timeout_now": _decode_timeout_now,
}


def encode_message(message: Message) -> pb.RaftMessage:
    """The library's message as it travels. Raises KeyError for a kind that must never be sent."""
    return _ENCODERS[message["type"]](message)


def decode_message(message: pb.RaftMessage) -> Message:
    """The library's message, checked. Raises MalformedMessage."""
    kind = message.WhichOneof("kind")
    if kind is None:
        raise MalformedMessage("a message is of no known kind")
    return _DECODERS[kind](getattr(message, kind))


@dataclass(frozen=True, kw_only=True, slots=True)
class Snapshot:
    """A snapshot taken apart. `configuration` is None in one from before members could change."""

    previous: Entry
    last: Entry
    configuration: Configuration | None
    state: bytes


def encode_snapshot(*, previous: Entry, last: Entry, configuration: Configuration, state: bytes) -> bytes:
    """A snapshot as it rests and travels."""
    return pb.RaftSnapshot(
        previous=encode_entry(previous),
        last=encode_entry(last),
        member_ids=[member.member_id for member in configuration.members],
        configuration=_configuration_message(configuration),
        state=state,
    ).SerializeToString(deterministic=True)


def decode_snapshot(record: bytes) -> Snapshot:
    """An encoded snapshot, taken apart and checked. Raises MalformedMessage."""
    try:
        snapshot = pb.RaftSnapshot.FromString(record)
    except DecodeError as error:
        raise MalformedMessage(f"a snapshot cannot be read: {error}") from error
    previous, last = decode_entry(snapshot.previous), decode_entry(snapshot.last)
    if last.log_index != previous.log_index + 1 or last.term < previous.term:
        raise MalformedMessage("a snapshot's last two entries are not neighbours")
    configuration = _configuration(snapshot.configuration) if snapshot.HasField("configuration") else None
    return Snapshot(previous=previous, last=last, configuration=configuration, state=snapshot.state)
