"""Each fault of PySyncObj 0.3.17 that matters here, shown on the unchanged library and absent under our rules."""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

import pytest

from stampede_rt_supernode.replication.library.node import LibraryNode
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.rules.raft_node import PeerAtFault
from stampede_rt_supernode.replication.storage.store import MemoryStore, StoredSnapshot, StoredState
from stampede_rt_supernode.replication.wire.messages import AppendReply, Message, VoteReply, VoteRequest
from stampede_rt_supernode.replication.wire.records import encode_snapshot
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.lone_node import (
    ABC,
    LoneNode,
    acknowledgement,
    append,
    command,
    piece,
    snapshot_pieces,
    vote,
)

ON_BOTH = pytest.mark.parametrize(
    "rules",
    [
        pytest.param(PreVoteElections, id="our rules"),
        pytest.param(
            LibraryNode,
            id="bare library",
            marks=pytest.mark.xfail(strict=True, raises=AssertionError, reason="PySyncObj 0.3.17"),
        ),
    ],
)


def is_success(message: Message) -> bool:
    return isinstance(message, AppendReply) and message.success


def pre_votes(sent: list[tuple[str, Message]]) -> list[bool]:
    return [message.pre_vote for _, message in sent if isinstance(message, VoteRequest)]


@ON_BOTH
def test_a_piece_of_a_snapshot_does_not_commit_entries_of_the_log(rules: type) -> None:
    lone = LoneNode(rules)
    lone.receive("b", append(1, (1, 0), [(2, 1), (3, 1), (4, 1)]))
    lone.receive("c", piece(5, snapshot_pieces(last=9, term=5)[0], commit=9))
    assert lone.node.commit_index == 1


@ON_BOTH
def test_a_late_append_deletes_no_entries_that_agree_with_it(rules: type) -> None:
    lone = LoneNode(rules)
    lone.receive("b", append(1, (1, 0), [(2, 1), (3, 1), (4, 1), (5, 1)]))
    lone.receive("b", append(1, (2, 1), [(3, 1)]))
    assert lone.held() == [(1, 0), (2, 1), (3, 1), (4, 1), (5, 1)]


@ON_BOTH
def test_an_acknowledgement_of_an_earlier_term_commits_nothing(rules: type) -> None:
    lone = LoneNode(rules)
    first_term = lone.lead()
    lone.receive("b", append(first_term + 1, (1, 0), []))
    term = lone.lead()
    lone.tick()
    lone.receive("b", acknowledgement(first_term, lone.log[-1].log_index + 1))
    lone.tick()
    assert term > first_term
    assert lone.node.commit_index == 1


@ON_BOTH
def test_a_repeated_vote_counts_once(rules: type) -> None:
    lone = LoneNode(rules, size=5)
    term = lone.campaign()
    lone.receive("b", vote(term))
    lone.receive("b", vote(term))
    assert not lone.node.is_leader


class LeftByTwoSteps(MemoryStore):
    """The store after a crash between the write of a snapshot and the trim of the log: entries 1 to 10, snapshot up to
    5.
    """

    def load(self) -> StoredState:
        entries = [Entry(command(f"{index}/1"), index, 1) for index in range(1, 11)]
        record = encode_snapshot(
            previous=entries[3], last=entries[4], configuration=ABC, state=ListMachine().snapshot()
        )
        return StoredState(entries=entries, term=1, commit_index=10, snapshot=StoredSnapshot.of(5, record))


@ON_BOTH
def test_a_gap_between_snapshot_and_log_is_reported_and_the_log_is_kept(rules: type) -> None:
    lone = LoneNode(rules, store=LeftByTwoSteps())
    if rules is PreVoteElections:
        with pytest.raises(AssertionError, match="does not begin where"):
            lone.node.open_snapshot()
    else:
        lone.node._SyncObj__loadDumpFile(clearJournal=False)
    assert lone.log[-1].log_index == 10


class BrokenMachine(ListMachine):
    def prepare_restore(self, snapshot: bytes) -> NoReturn:
        raise ValueError("this state cannot be read")


@ON_BOTH
def test_a_snapshot_that_cannot_be_loaded_is_not_acknowledged(rules: type) -> None:
    lone = LoneNode(rules, machine=BrokenMachine())
    *chunks, last = snapshot_pieces(last=9, term=5)
    replies = [reply for chunk in chunks for reply in lone.receive("b", piece(5, chunk, commit=9))]
    if rules is PreVoteElections:
        replies += lone.receive("b", piece(5, last, commit=9))
        with pytest.raises(PeerAtFault, match=r"b has sent a snapshot: .*cannot be read"):
            lone.open_snapshot()
        assert lone.held() == [(1, 0)]
    else:
        replies += lone.receive("b", piece(5, last, commit=9))
    assert not any(is_success(message) for _, message in replies + lone.sent_messages())


@ON_BOTH
def test_a_node_does_not_follow_a_leader_that_is_not_a_member(rules: type) -> None:
    lone = LoneNode(rules)
    stranger = type(next(iter(lone.node.other_voters)))("stranger")
    lone.node.receive(stranger, append(7, (1, 0), []))
    assert lone.node.term == 0


def test_a_leader_that_contradicts_committed_entries_is_at_fault_and_changes_nothing() -> None:
    lone = LoneNode()
    lone.receive("b", append(1, (1, 0), [(2, 1), (3, 1)], commit=3))
    lone.tick()
    with pytest.raises(PeerAtFault, match="3 is committed"):
        lone.receive("c", append(2, (2, 1), [(3, 2)]))
    assert lone.held() == [(1, 0), (2, 1), (3, 1)]


def test_a_conflict_above_the_commit_index_replaces_the_tail() -> None:
    lone = LoneNode()
    lone.receive("b", append(1, (1, 0), [(2, 1), (3, 1), (4, 1)], commit=2))
    replies = lone.receive("c", append(2, (2, 1), [(3, 2)], commit=2))
    assert lone.held() == [(1, 0), (2, 1), (3, 2)]
    assert replies[0][1] == AppendReply(term=2, next_index=4, reset=False, success=True)


def test_the_commit_index_does_not_pass_the_match_index() -> None:
    lone = LoneNode()
    lone.receive("b", append(1, (1, 0), [(2, 1), (3, 1), (4, 1)]))
    lone.receive("c", append(2, (1, 0), [], commit=4))
    assert lone.node.commit_index == 1


def test_a_leader_of_an_older_term_learns_the_newer_term_and_steps_down() -> None:
    lone = LoneNode()
    lone.receive("b", append(3, (1, 0), []))
    [(to, reply)] = lone.receive("c", append(2, (1, 0), []))
    assert (to, reply) == ("c", AppendReply(term=3, next_index=2, reset=False, success=False))
    leader = LoneNode()
    term = leader.lead()
    leader.receive("b", acknowledgement(term + 5, 2, success=False))
    assert not leader.node.is_leader
    assert leader.node.term == term + 5


def test_a_whole_snapshot_replaces_state_and_log_and_is_acknowledged() -> None:
    lone = LoneNode()
    replies = []
    for chunk in snapshot_pieces(last=9, term=5):
        replies += lone.receive("b", piece(5, chunk, commit=12))
    lone.open_snapshot()
    replies += lone.receive("b", append(5, (9, 5), [], commit=12))
    assert [is_success(message) for _, message in replies] == [False] * (len(replies) - 1) + [True]
    assert replies[-1][1] == AppendReply(term=5, next_index=10, reset=False, success=True)
    assert lone.held() == [(8, 5), (9, 5)]
    assert lone.machine.entries[-1] == (9, b"9/5")
    assert lone.node.last_applied == lone.node.commit_index == 9


def test_a_snapshot_keeps_the_later_entries_that_agree_with_it() -> None:
    lone = LoneNode()
    lone.receive("b", append(5, (1, 0), [(index, 5) for index in range(2, 13)]))
    for chunk in snapshot_pieces(last=9, term=5):
        lone.receive("b", piece(5, chunk, commit=9))
    lone.open_snapshot()
    assert lone.held() == [(8, 5), (9, 5), (10, 5), (11, 5), (12, 5)]


def test_a_snapshot_older_than_the_state_changes_nothing() -> None:
    lone = LoneNode()
    lone.receive("b", append(5, (1, 0), [(index, 5) for index in range(2, 13)], commit=12))
    lone.tick()
    for chunk in snapshot_pieces(last=9, term=5):
        lone.receive("b", piece(5, chunk, commit=9))
    lone.open_snapshot()
    assert lone.machine.entries[-1][0] == 12
    assert lone.held()[-1] == (12, 5)


def test_a_snapshot_with_a_lost_piece_is_not_opened() -> None:
    lone = LoneNode()
    chunks = snapshot_pieces(last=9, term=5, size=20)
    assert len(chunks) > 3
    for chunk in [chunks[0], *chunks[2:]]:
        lone.receive("b", piece(5, chunk, commit=9))
    lone.open_snapshot()
    assert lone.machine.entries == []
    assert lone.node.last_applied == 1


def test_a_snapshot_in_which_a_bit_has_changed_is_not_opened() -> None:
    lone = LoneNode()
    chunks = snapshot_pieces(last=9, term=5, size=20)
    changed = bytearray(chunks[-1].data)
    changed[-1] ^= 1
    chunks[-1] = replace(chunks[-1], data=bytes(changed))
    replies = [lone.receive("b", piece(5, chunk, commit=9)) for chunk in chunks]
    assert not lone.node.keeper.is_opening
    assert not any(is_success(message) for reply in replies for _, message in reply)
    lone.open_snapshot()
    assert lone.machine.entries == []


def test_a_member_with_a_live_leader_gives_no_pre_vote() -> None:
    lone = LoneNode()
    request = VoteRequest(term=2, last_log_index=9, last_log_term=1, pre_vote=True)
    lone.receive("b", append(1, (1, 0), []))
    assert lone.receive("c", request) == []
    lone.now += 5.0
    [(to, reply)] = lone.receive("c", request)
    assert (to, reply) == ("c", VoteReply(term=2, pre_vote=True, voter_term=1))
    assert lone.node.term == 1


def test_an_election_begins_only_after_a_majority_would_vote() -> None:
    lone = LoneNode()
    lone.now += 10.0
    lone.node.before_tick()
    assert pre_votes(lone.tick()) == [True, True]
    assert lone.node.term == 0
    lone.receive("b", VoteReply(term=1, pre_vote=True))
    lone.node.before_tick()
    assert pre_votes(lone.tick()) == [False, False]
    assert lone.node.term == 1
