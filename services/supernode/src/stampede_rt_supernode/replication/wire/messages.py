"""The messages between members, as values. Pure. `codec` converts them from and to their wire form.

The names come from the Raft paper (Ongaro and Ousterhout 2014, figures 2 and 13), and from Ongaro's dissertation.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

from stampede_rt_supernode.replication.log_entries import Entry

# A log position, and the digest of the state at that position. The digest is empty if it is unknown.
StateDigest = tuple[int, bytes]

NO_DIGEST: StateDigest = (0, b"")


@dataclass(frozen=True, kw_only=True, slots=True)
class AppendEntries:
    """A leader's entries after `previous_index`; without entries, a heartbeat.

    The reply echoes `round`, see `ConfirmedReads`. `digest`: the position that the leader names, and its own digest
    there. `majority_digest`: the digest that more than half of all members have at that position (rules/digests.py).
    """

    term: int
    commit_index: int
    previous_index: int
    previous_term: int
    entries: Sequence[Entry]
    round: int = 0
    digest: StateDigest = NO_DIGEST
    majority_digest: StateDigest = NO_DIGEST


@dataclass(frozen=True, kw_only=True, slots=True)
class SnapshotChunk:
    """A part of an encoded snapshot. The snapshot covers the log up to `last_log_index`.

    `total_bytes` and the checksum belong to the whole snapshot.
    """

    last_log_index: int
    offset_bytes: int
    total_bytes: int
    sha256: bytes
    data: bytes

    @property
    def is_last(self) -> bool:
        """Whether this is the last part of the snapshot."""
        return self.offset_bytes + len(self.data) == self.total_bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class InstallSnapshot:
    """A part of a leader's snapshot, for a member that needs entries which the leader's log no longer has.

    `chunk` None: a heartbeat to such a member. The other fields are as in AppendEntries.
    """

    term: int
    commit_index: int
    chunk: SnapshotChunk | None
    round: int = 0
    digest: StateDigest = NO_DIGEST
    majority_digest: StateDigest = NO_DIGEST


@dataclass(frozen=True, kw_only=True, slots=True)
class AppendReply:
    """A member's reply to a leader. With `success` the member holds all of the leader's entries before `next_index`.

    `reset`: the leader must go back to `next_index`. `digest`: the member's own digest at the position that the leader
    named last.
    """

    term: int
    next_index: int
    reset: bool
    success: bool
    round: int = 0
    digest: StateDigest = NO_DIGEST


@dataclass(frozen=True, kw_only=True, slots=True)
class VoteRequest:
    """A candidate asks for a vote in `term`, or, with `pre_vote`, whether it would get one."""

    term: int
    last_log_index: int
    last_log_term: int
    pre_vote: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class VoteReply:
    """A vote in `term`. With `pre_vote`: the sender would give this vote, and `voter_term` is its own term."""

    term: int
    pre_vote: bool = False
    voter_term: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class TimeoutNow:
    """The leader of `term` asks a member to stand for election immediately."""

    term: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ForwardedCommand:
    """A command that a follower passes on to the leader. The first byte of `command` is the kind of the entry."""

    request_id: int
    command: bytes


class ForwardRefusal(enum.Enum):
    """The reason why a forwarded command is certainly not in the log."""

    QUEUE_FULL = enum.auto()
    MISSING_LEADER = enum.auto()
    NOT_LEADER = enum.auto()
    # The state does not accept the command at its present feature level.
    DENIED = enum.auto()


@dataclass(frozen=True, kw_only=True, slots=True)
class ForwardedCommandReply:
    """The position of a forwarded command in the leader's log, or the reason why it is not there."""

    request_id: int
    log_index: int = 0
    log_term: int = 0
    refusal: ForwardRefusal | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadIndexRequest:
    """A follower asks the leader for a position that includes every acknowledged write."""

    request_id: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadIndexReply:
    """The answer to a ReadIndexRequest: the position; 0 if the asked member knows none, for example as a follower."""

    request_id: int
    read_index: int


FromLeader = AppendEntries | InstallSnapshot
Message = (
    FromLeader
    | AppendReply
    | VoteRequest
    | VoteReply
    | TimeoutNow
    | ForwardedCommand
    | ForwardedCommandReply
    | ReadIndexRequest
    | ReadIndexReply
)
