"""A single Raft node that gets hand-written messages. Tests inspect its log and its answers."""

from __future__ import annotations

import hashlib
import random

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.rules.node_builder import build_node
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.store import MemoryStore, Store
from stampede_rt_supernode.replication.threads.worker_thread import RunInBackground, run_inline
from stampede_rt_supernode.replication.wire.buffered_transport import LinkConnected, MessageReceived
from stampede_rt_supernode.replication.wire.codec import decode_message, encode_message
from stampede_rt_supernode.replication.wire.messages import (
    AppendEntries,
    AppendReply,
    InstallSnapshot,
    Message,
    SnapshotChunk,
    VoteReply,
)
from stampede_rt_supernode.replication.wire.records import encode_snapshot
from tests.support.supernode.list_machine import ListMachine

LIBRARY_COMMAND = b"\x00"
ABC = Configuration.of([Member(member_id=name, address=f"{name}:1") for name in "abc"])


def command(text: str) -> bytes:
    """Return a log command, with the byte for its kind."""
    return LIBRARY_COMMAND + text.encode()


class LoneNode:
    """Member `a` of `a`, `b`, `c`, ... All links are up, and the clock does not advance."""

    def __init__(
        self,
        rules: type = PreVoteElections,
        *,
        size: int = 3,
        store: Store | None = None,
        machine: ListMachine | None = None,
        piece_bytes: int = 100,
        run_in_background: RunInBackground = run_inline,
    ) -> None:
        members = [Member(member_id=name, address=f"{name}:1") for name in "abcdefg"[:size]]
        settings = ReplicationSettings(
            self_member=members[0], initial_members=members, snapshot_piece_bytes=piece_bytes
        )
        self.now = 100.0
        self.machine = machine or ListMachine()
        self.log = RaftLog(store or MemoryStore())
        self.node = build_node(
            settings,
            self.machine,
            log=self.log,
            has_room=lambda member_id: True,
            clock=lambda: self.now,
            random_source=random.Random(1),
            rules=rules,
            run_in_background=run_in_background,
        )
        for member in members[1:]:
            self.node.transport.deliver(LinkConnected(member.member_id))

    def receive(self, sender: str, message: Message) -> list[tuple[str, Message]]:
        """Give the node a message, and return its answers."""
        self.node.transport.deliver(MessageReceived(sender, message))
        return self.sent_messages()

    def sent_messages(self) -> list[tuple[str, Message]]:
        """Return the node's messages since the last call."""
        return [(to, decode_message(encode_message(message))) for to, message in self.node.transport.take_outbox()]

    def open_snapshot(self) -> None:
        """Let the node process a received snapshot, as the steps of a replica do."""
        for _ in range(10):
            self.node.install_opened()

    def tick(self) -> list[tuple[str, Message]]:
        self.node.tick()
        return self.sent_messages()

    def campaign(self) -> int:
        """Have the node stand for election now; return the term."""
        self.node.election_deadline = float("-inf")
        self.tick()
        return int(self.node.term)

    def lead(self) -> int:
        """Make the node the leader; return the term."""
        term = self.campaign()
        for other in list(self.node.other_voters):
            self.receive(other.id, vote(term))
        assert self.node.is_leader
        return term

    def held(self) -> list[tuple[int, int]]:
        """Return (position, term) of every entry."""
        return [(entry.log_index, entry.term) for entry in self.log[:]]


def append(term: int, previous: tuple[int, int], entries: list[tuple[int, int]], *, commit: int = 1) -> AppendEntries:
    """Return a leader's entries. `previous` and `entries` are (position, term)."""
    return AppendEntries(
        term=term,
        commit_index=commit,
        previous_index=previous[0],
        previous_term=previous[1],
        entries=[Entry(command(f"{index}/{of}"), index, of) for index, of in entries],
    )


def piece(term: int, chunk: SnapshotChunk, *, commit: int) -> InstallSnapshot:
    """A piece of a leader's snapshot."""
    return InstallSnapshot(term=term, commit_index=commit, chunk=chunk)


def vote(term: int) -> VoteReply:
    return VoteReply(term=term)


def acknowledgement(term: int, next_index: int, *, success: bool = True) -> AppendReply:
    return AppendReply(term=term, next_index=next_index, reset=False, success=success)


def snapshot_pieces(*, last: int, term: int, size: int = 100) -> list[SnapshotChunk]:
    """Return the pieces of a snapshot of members a, b and c up to position `last`."""
    machine = ListMachine()
    for index in range(2, last + 1):
        machine.apply(index, f"{index}/{term}".encode())
    record = encode_snapshot(
        previous=Entry(command(f"{last - 1}/{term}"), last - 1, term),
        last=Entry(command(f"{last}/{term}"), last, term),
        configuration=ABC,
        state=machine.snapshot(),
    )
    return [
        SnapshotChunk(
            last_log_index=last,
            offset_bytes=offset,
            total_bytes=len(record),
            sha256=hashlib.sha256(record).digest(),
            data=record[offset : offset + size],
        )
        for offset in range(0, len(record), size)
    ]
