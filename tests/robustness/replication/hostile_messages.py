"""Well-formed messages with false contents, as a hostile holder of valid credentials may send them.

A seed decides the messages. Half of the numbers are close to the victim's own numbers, because a missing check shows
there first. The other numbers are arbitrary.
"""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable, Sequence

from google.protobuf.message import Message as ProtobufMessage

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import COMMAND, CONFIGURATION, NO_OP, Entry
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.replication.wire.records import encode_configuration, encode_snapshot
from tests.support.supernode.list_machine import ListMachine

FAR = (0, 1, 2**20, 2**31, 2**61, 2**62, 2**62 + 1, 2**63 - 1, 2**63, 2**64 - 1)
NAMES = "abcdexyz"


class FalseMessages:
    """Draws messages to one replica, with numbers near those in the state of this replica."""

    def __init__(self, random_source: random.Random, victim: RaftReplica, read_request_ids: Sequence[int] = ()) -> None:
        """`read_request_ids`: ids of requests that the victim has sent."""
        self._random_source = random_source
        self._victim = victim
        self._read_request_ids = read_request_ids
        self._drawn: tuple[Callable[[], ProtobufMessage], ...] = (
            self._append,
            self._append,
            self._snapshot_piece,
            self._append_reply,
            self._vote_request,
            self._vote_reply,
            self._command,
            self._command_reply,
            self._read,
            self._read_reply,
            self._timeout_now,
        )

    def message(self) -> pb.RaftMessage:
        """Return the next message."""
        return self._random_source.choice(self._drawn)()  # type: ignore[return-value]

    def _near(self, number: int) -> int:
        if self._random_source.random() < 0.15:
            return self._random_source.choice(FAR)
        return max(0, number + self._random_source.choice((0, 0, 0, 1, 1, -1, -2, 2, 3)))

    def _request_id(self) -> int:
        return (
            self._random_source.choice(self._read_request_ids)
            if self._read_request_ids and self._random_source.random() < 0.8
            else self._near(5)
        )

    def _term(self) -> int:
        return self._near(self._victim.status().term)

    def _index(self) -> int:
        log = self._victim._log
        return self._near(self._random_source.choice((log[0].log_index, log.commit_index, log.end()[1])))

    def _bytes(self, most: int = 40) -> bytes:
        return self._random_source.randbytes(self._random_source.randint(0, most))

    def _member(self) -> Member:
        name = self._random_source.choice(NAMES)
        return Member(member_id=name, address=f"{name}:{self._random_source.randint(1, 2)}")

    def _entry_command(self) -> bytes:
        kind = self._random_source.choice((COMMAND, COMMAND, NO_OP, CONFIGURATION, 9))
        if kind == CONFIGURATION and self._random_source.random() < 0.8:
            members = {member.member_id: member for member in (self._member() for _ in range(3))}
            retired = [name for name in NAMES if name not in members and self._random_source.random() < 0.1]
            return encode_configuration(Configuration.of(list(members.values()), retired))
        return bytes((kind,)) + self._bytes()

    def _append(self) -> pb.RaftMessage:
        log, previous = self._victim._log, self._index()
        held = log.entry_at(previous)
        term = self._term()
        body = pb.RaftAppendEntries(
            term=term,
            commit_index=self._index(),
            round=self._near(1),
            previous_log_index=previous,
            previous_log_term=held.term if held and self._random_source.random() < 0.8 else self._term(),
            digest_index=self._index(),
            digest=self._bytes(16),
        )
        for number in range(self._random_source.randint(0, 4)):
            body.entries.add(
                log_index=min(previous + 1 + number, 2**64 - 1)
                if self._random_source.random() < 0.95
                else self._index(),
                term=term if self._random_source.random() < 0.7 else self._term(),
                command=self._entry_command(),
            )
        return pb.RaftMessage(append_entries=body)

    def _snapshot_piece(self) -> pb.RaftMessage:
        """Return a whole snapshot that may even be correct, a part of one, or random bytes."""
        record = self._snapshot() if self._random_source.random() < 0.7 else self._bytes(200) or b"x"
        start = 0 if self._random_source.random() < 0.8 else self._random_source.randrange(len(record))
        end = len(record) if self._random_source.random() < 0.8 else self._random_source.randint(start, len(record))
        chunk = pb.RaftSnapshotChunk(
            last_log_index=self._index(),
            offset_bytes=start if self._random_source.random() < 0.95 else self._index(),
            total_bytes=len(record) if self._random_source.random() < 0.95 else self._index(),
            sha256=hashlib.sha256(record).digest() if self._random_source.random() < 0.9 else self._bytes(),
            data=record[start:end],
        )
        body = pb.RaftAppendEntries(term=self._term(), commit_index=self._index(), installing_snapshot=True)
        if self._random_source.random() < 0.9:
            body.chunk.CopyFrom(chunk)
        return pb.RaftMessage(append_entries=body)

    def _snapshot(self) -> bytes:
        last, machine = max(2, self._index()), ListMachine()
        term = self._term()
        if last >= 2**62:
            return self._bytes(100) or b"x"
        machine.entries = [(max(1, last - 1), b"forged")]
        return encode_snapshot(
            previous=Entry(b"\x00p", last - 1, max(0, self._near(term)) % 2**63),
            last=Entry(b"\x00l", last, term % 2**63),
            configuration=Configuration.of([self._member()]),
            state=machine.snapshot() if self._random_source.random() < 0.8 else self._bytes(),
        )

    def _append_reply(self) -> pb.RaftMessage:
        body = pb.RaftAppendReply(
            term=self._term(),
            round=self._near(1),
            next_index=self._index(),
            reset=self._random_source.random() < 0.5,
            success=self._random_source.random() < 0.5,
        )
        return pb.RaftMessage(append_reply=body)

    def _vote_request(self) -> pb.RaftMessage:
        body = pb.RaftVoteRequest(
            term=self._term(),
            last_log_index=self._index(),
            last_log_term=self._term(),
            pre_vote=self._random_source.random() < 0.5,
        )
        return pb.RaftMessage(vote_request=body)

    def _vote_reply(self) -> pb.RaftMessage:
        pre_vote = self._random_source.random() < 0.5
        return pb.RaftMessage(
            vote_reply=pb.RaftVoteReply(term=self._term(), pre_vote=pre_vote, voter_term=self._term())
        )

    def _command(self) -> pb.RaftMessage:
        body = pb.RaftForwardedCommand(request_id=self._near(5), command=self._entry_command())
        return pb.RaftMessage(forwarded_command=body)

    def _command_reply(self) -> pb.RaftMessage:
        body = pb.RaftForwardedCommandReply(
            request_id=self._request_id(),
            log_index=self._index(),
            log_term=self._term(),
            refusal=self._random_source.choice((0, 0, 1, 2, 3, 4, 9)),  # type: ignore[arg-type]  # 9 names no refusal
        )
        return pb.RaftMessage(forwarded_command_reply=body)

    def _read(self) -> pb.RaftMessage:
        return pb.RaftMessage(read_index_request=pb.RaftReadIndexRequest(request_id=self._near(5)))

    def _read_reply(self) -> pb.RaftMessage:
        body = pb.RaftReadIndexReply(request_id=self._request_id(), read_index=self._index())
        return pb.RaftMessage(read_index_reply=body)

    def _timeout_now(self) -> pb.RaftMessage:
        return pb.RaftMessage(timeout_now=pb.RaftTimeoutNow(term=self._term()))
