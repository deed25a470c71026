"""Converts messages between members from and to protobuf, the only form on the wire.

Decoding checks every number, size and kind. So a decoded message can make a rule raise nothing but PeerAtFault.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.log_entries import COMMAND
from stampede_rt_supernode.replication.settings import SNAPSHOT_PIECE_BYTES_MAX
from stampede_rt_supernode.replication.wire.messages import (
    NO_DIGEST,
    AppendEntries,
    AppendReply,
    ForwardedCommand,
    ForwardedCommandReply,
    ForwardRefusal,
    FromLeader,
    InstallSnapshot,
    Message,
    ReadIndexReply,
    ReadIndexRequest,
    SnapshotChunk,
    StateDigest,
    TimeoutNow,
    VoteReply,
    VoteRequest,
)
from stampede_rt_supernode.replication.wire.records import (
    MalformedMessage,
    check_command,
    checked_number,
    decode_entry,
    encode_entry,
)

# The largest snapshot of which this member accepts a piece.
SNAPSHOT_BYTES_MAX = 1 << 30
# This member reads only this many bytes of a longer digest.
DIGEST_BYTES_MAX = 64


def _encode_append(message: AppendEntries) -> pb.RaftMessage:
    body = _from_leader(message)
    body.previous_log_index = message.previous_index
    body.previous_log_term = message.previous_term
    body.entries.extend(encode_entry(entry) for entry in message.entries)
    return pb.RaftMessage(append_entries=body)


def _encode_install(message: InstallSnapshot) -> pb.RaftMessage:
    body, chunk = _from_leader(message), message.chunk
    body.installing_snapshot = True
    if chunk is not None:
        body.chunk.CopyFrom(
            pb.RaftSnapshotChunk(
                last_log_index=chunk.last_log_index,
                offset_bytes=chunk.offset_bytes,
                total_bytes=chunk.total_bytes,
                sha256=chunk.sha256,
                data=chunk.data,
            )
        )
    return pb.RaftMessage(append_entries=body)


def _from_leader(message: FromLeader) -> pb.RaftAppendEntries:
    index, digest = message.digest
    most_index, most_digest = message.majority_digest
    return pb.RaftAppendEntries(
        term=message.term,
        commit_index=message.commit_index,
        round=message.round,
        digest_index=index,
        digest=digest,
        most_digest_index=most_index,
        most_digest=most_digest,
    )


def _decode_append(body: pb.RaftAppendEntries) -> FromLeader:
    term, commit_index = checked_number(body.term), checked_number(body.commit_index)
    round_number, digest = checked_number(body.round), _digest(body.digest_index, body.digest)
    majority_digest = _digest(body.most_digest_index, body.most_digest)
    if body.installing_snapshot:
        chunk = _checked_chunk(body.chunk) if body.HasField("chunk") else None
        return InstallSnapshot(
            term=term,
            commit_index=commit_index,
            chunk=chunk,
            round=round_number,
            digest=digest,
            majority_digest=majority_digest,
        )
    previous, previous_term = checked_number(body.previous_log_index), checked_number(body.previous_log_term)
    entries = [decode_entry(entry) for entry in body.entries]
    entry_term = previous_term
    for offset, entry in enumerate(entries, start=1):
        if entry.log_index != previous + offset or not entry_term <= entry.term <= term:
            raise MalformedMessage(f"entry {entry.log_index} does not belong after {previous} in term {term}")
        entry_term = entry.term
    return AppendEntries(
        term=term,
        commit_index=commit_index,
        previous_index=previous,
        previous_term=previous_term,
        entries=entries,
        round=round_number,
        digest=digest,
        majority_digest=majority_digest,
    )


def _digest(index: int, digest: bytes) -> StateDigest:
    return (checked_number(index), digest[:DIGEST_BYTES_MAX]) if digest else NO_DIGEST


def _checked_chunk(chunk: pb.RaftSnapshotChunk) -> SnapshotChunk:
    end = chunk.offset_bytes + len(chunk.data)
    if not 0 < chunk.total_bytes <= SNAPSHOT_BYTES_MAX or end > chunk.total_bytes:
        raise MalformedMessage(f"a snapshot piece ends at {end} of {chunk.total_bytes} bytes")
    if not 0 < len(chunk.data) <= SNAPSHOT_PIECE_BYTES_MAX or len(chunk.sha256) != 32:
        raise MalformedMessage("a snapshot piece is empty, too large or without checksum")
    return SnapshotChunk(
        last_log_index=checked_number(chunk.last_log_index),
        offset_bytes=chunk.offset_bytes,
        total_bytes=chunk.total_bytes,
        sha256=chunk.sha256,
        data=chunk.data,
    )


def _encode_append_reply(message: AppendReply) -> pb.RaftMessage:
    index, digest = message.digest
    body = pb.RaftAppendReply(
        term=message.term,
        round=message.round,
        next_index=message.next_index,
        reset=message.reset,
        success=message.success,
        digest_index=index,
        digest=digest,
    )
    return pb.RaftMessage(append_reply=body)


def _decode_append_reply(body: pb.RaftAppendReply) -> AppendReply:
    if body.next_index == 0:
        raise MalformedMessage("next_index is 0")
    return AppendReply(
        term=checked_number(body.term),
        round=checked_number(body.round),
        next_index=checked_number(body.next_index),
        reset=body.reset,
        success=body.success,
        digest=_digest(body.digest_index, body.digest),
    )


def _encode_vote_request(message: VoteRequest) -> pb.RaftMessage:
    body = pb.RaftVoteRequest(
        term=message.term,
        last_log_index=message.last_log_index,
        last_log_term=message.last_log_term,
        pre_vote=message.pre_vote,
    )
    return pb.RaftMessage(vote_request=body)


def _decode_vote_request(body: pb.RaftVoteRequest) -> VoteRequest:
    return VoteRequest(
        term=checked_number(body.term),
        last_log_index=checked_number(body.last_log_index),
        last_log_term=checked_number(body.last_log_term),
        pre_vote=body.pre_vote,
    )


def _encode_vote_reply(message: VoteReply) -> pb.RaftMessage:
    body = pb.RaftVoteReply(term=message.term, pre_vote=message.pre_vote, voter_term=message.voter_term)
    return pb.RaftMessage(vote_reply=body)


def _decode_vote_reply(body: pb.RaftVoteReply) -> VoteReply:
    return VoteReply(term=checked_number(body.term), pre_vote=body.pre_vote, voter_term=checked_number(body.voter_term))


def _encode_command(message: ForwardedCommand) -> pb.RaftMessage:
    body = pb.RaftForwardedCommand(request_id=message.request_id, command=message.command)
    return pb.RaftMessage(forwarded_command=body)


def _decode_command(body: pb.RaftForwardedCommand) -> ForwardedCommand:
    command = check_command(body.command)
    if command[0] != COMMAND:
        raise MalformedMessage("only commands are forwarded")
    return ForwardedCommand(request_id=checked_number(body.request_id), command=command)


def _encode_command_reply(message: ForwardedCommandReply) -> pb.RaftMessage:
    body = pb.RaftForwardedCommandReply(
        request_id=message.request_id, log_index=message.log_index, log_term=message.log_term
    )
    if message.refusal is not None:
        body.refusal = _WIRE_REFUSALS[message.refusal]
    return pb.RaftMessage(forwarded_command_reply=body)


def _decode_command_reply(body: pb.RaftForwardedCommandReply) -> ForwardedCommandReply:
    request_id = checked_number(body.request_id)
    if body.refusal == pb.RAFT_REFUSAL_UNSPECIFIED:
        log_index, log_term = checked_number(body.log_index), checked_number(body.log_term)
        return ForwardedCommandReply(request_id=request_id, log_index=log_index, log_term=log_term)
    if body.refusal not in _REFUSALS:
        raise MalformedMessage(f"refusal {body.refusal} is not known")
    return ForwardedCommandReply(request_id=request_id, refusal=_REFUSALS[body.refusal])


_WIRE_REFUSALS = {
    ForwardRefusal.QUEUE_FULL: pb.RAFT_REFUSAL_QUEUE_FULL,
    ForwardRefusal.MISSING_LEADER: pb.RAFT_REFUSAL_MISSING_LEADER,
    ForwardRefusal.NOT_LEADER: pb.RAFT_REFUSAL_NOT_LEADER,
    ForwardRefusal.DENIED: pb.RAFT_REFUSAL_DENIED,
}
_REFUSALS = {wire: refusal for refusal, wire in _WIRE_REFUSALS.items()}


def _encode_read(message: ReadIndexRequest) -> pb.RaftMessage:
    return pb.RaftMessage(read_index_request=pb.RaftReadIndexRequest(request_id=message.request_id))


def _decode_read(body: pb.RaftReadIndexRequest) -> ReadIndexRequest:
    return ReadIndexRequest(request_id=checked_number(body.request_id))


def _encode_read_reply(message: ReadIndexReply) -> pb.RaftMessage:
    body = pb.RaftReadIndexReply(request_id=message.request_id, read_index=message.read_index)
    return pb.RaftMessage(read_index_reply=body)


def _decode_read_reply(body: pb.RaftReadIndexReply) -> ReadIndexReply:
    return ReadIndexReply(request_id=checked_number(body.request_id), read_index=checked_number(body.read_index))


def _encode_timeout_now(message: TimeoutNow) -> pb.RaftMessage:
    return pb.RaftMessage(timeout_now=pb.RaftTimeoutNow(term=message.term))


def _decode_timeout_now(body: pb.RaftTimeoutNow) -> TimeoutNow:
    return TimeoutNow(term=checked_number(body.term))


_ENCODERS: dict[type, Callable[[Any], pb.RaftMessage]] = {
    AppendEntries: _encode_append,
    InstallSnapshot: _encode_install,
    AppendReply: _encode_append_reply,
    VoteRequest: _encode_vote_request,
    VoteReply: _encode_vote_reply,
    ForwardedCommand: _encode_command,
    ForwardedCommandReply: _encode_command_reply,
    ReadIndexRequest: _encode_read,
    ReadIndexReply: _encode_read_reply,
    TimeoutNow: _encode_timeout_now,
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
    """The protobuf form of a message."""
    return _ENCODERS[type(message)](message)


def decode_message(message: pb.RaftMessage) -> Message:
    """The message, checked. Raises MalformedMessage."""
    kind = message.WhichOneof("kind")
    if kind is None:
        raise MalformedMessage("a message is of no known kind")
    return _DECODERS[kind](getattr(message, kind))
