"""Converts messages between the library's dictionaries and our dataclasses, on their way out of and into the library.

Under our rules the library itself only asks for votes, and sends and receives forwarded commands. Some tests
compare the faults of the unchanged library with our rules. That library also sends the other messages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt_supernode.replication.wire.messages import (
    AppendEntries,
    AppendReply,
    ForwardedCommand,
    ForwardedCommandReply,
    ForwardRefusal,
    InstallSnapshot,
    Message,
    TimeoutNow,
    VoteReply,
    VoteRequest,
)

LibraryMessage = dict[str, Any]

# The library's FAIL_REASON numbers that a refusal can carry.
_REASONS = {
    ForwardRefusal.QUEUE_FULL: 1,
    ForwardRefusal.MISSING_LEADER: 2,
    ForwardRefusal.NOT_LEADER: 4,
    ForwardRefusal.DENIED: 6,
}
_REFUSALS = {reason: refusal for refusal, reason in _REASONS.items()}


def from_library(message: LibraryMessage) -> Message:
    """Our form of a message of the library. Raises KeyError for a kind that must never be sent."""
    return _FROM_LIBRARY[message["type"]](message)


def to_library(message: Message) -> LibraryMessage:
    """The library's form of our message. Raises KeyError for a message that the library does not know."""
    kind, body = _TO_LIBRARY[type(message)]
    return {"type": kind, **body(message)}


def _from_append(message: LibraryMessage) -> AppendEntries:
    return AppendEntries(
        term=message["term"],
        commit_index=message["commit_index"],
        previous_index=message["prevLogIdx"],
        previous_term=message["prevLogTerm"],
        entries=message["entries"],
    )


def _from_append_reply(message: LibraryMessage) -> AppendReply:
    return AppendReply(term=0, next_index=message["next_node_idx"], reset=message["reset"], success=message["success"])


def _from_vote_request(message: LibraryMessage) -> VoteRequest:
    return VoteRequest(
        term=message["term"], last_log_index=message["last_log_index"], last_log_term=message["last_log_term"]
    )


def _from_command(message: LibraryMessage) -> ForwardedCommand:
    return ForwardedCommand(request_id=message["request_id"], command=message["command"])


def _from_command_reply(message: LibraryMessage) -> ForwardedCommandReply:
    request_id = message["request_id"]
    if "error" in message:
        return ForwardedCommandReply(request_id=request_id, refusal=_REFUSALS[message["error"]])
    return ForwardedCommandReply(request_id=request_id, log_index=message["log_idx"], log_term=message["log_term"])


def _to_append(message: AppendEntries) -> LibraryMessage:
    return {
        "term": message.term,
        "commit_index": message.commit_index,
        "prevLogIdx": message.previous_index,
        "prevLogTerm": message.previous_term,
        "entries": message.entries,
    }


def _to_install(message: InstallSnapshot) -> LibraryMessage:
    return {"term": message.term, "commit_index": message.commit_index, "serialized": message.chunk}


def _to_append_reply(message: AppendReply) -> LibraryMessage:
    return {"next_node_idx": message.next_index, "reset": message.reset, "success": message.success}


def _to_vote_request(message: VoteRequest) -> LibraryMessage:
    return {
        "term": message.term,
        "last_log_index": message.last_log_index,
        "last_log_term": message.last_log_term,
    }


def _to_command(message: ForwardedCommand) -> LibraryMessage:
    return {"request_id": message.request_id, "command": message.command}


def _to_command_reply(message: ForwardedCommandReply) -> LibraryMessage:
    if message.refusal is not None:
        return {"request_id": message.request_id, "error": _REASONS[message.refusal]}
    return {"request_id": message.request_id, "log_idx": message.log_index, "log_term": message.log_term}


_FROM_LIBRARY: dict[str, Callable[[LibraryMessage], Message]] = {
    "append_entries": _from_append,
    "next_node_idx": _from_append_reply,
    "request_vote": _from_vote_request,
    "response_vote": lambda message: VoteReply(term=message["term"]),
    "apply_command": _from_command,
    "apply_command_response": _from_command_reply,
}
_TO_LIBRARY: dict[type, tuple[str, Callable[[Any], LibraryMessage]]] = {
    AppendEntries: ("append_entries", _to_append),
    InstallSnapshot: ("append_entries", _to_install),
    AppendReply: ("next_node_idx", _to_append_reply),
    VoteRequest: ("request_vote", _to_vote_request),
    VoteReply: ("response_vote", lambda message: {"term": message.term}),
    ForwardedCommand: ("apply_command", _to_command),
    ForwardedCommandReply: ("apply_command_response", _to_command_reply),
    TimeoutNow: ("timeout_now", lambda message: {"term": message.term}),
}
