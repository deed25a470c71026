"""A hostile holder of valid credentials sends messages to a node. The node counts the sender as at fault, or ignores
the message, and goes on.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.library.node import CANDIDATE, ProposalFailure
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.rules.elections import TERMS_AHEAD_MAX
from stampede_rt_supernode.replication.rules.raft_node import PeerAtFault
from stampede_rt_supernode.replication.storage.store import Promise
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    MembersReported,
    MessageReceived,
    NodeIntroduced,
)
from stampede_rt_supernode.replication.wire.messages import (
    AppendReply,
    ForwardedCommandReply,
    Message,
    ReadIndexRequest,
    TimeoutNow,
    VoteReply,
    VoteRequest,
)
from stampede_rt_supernode.replication.wire.records import encode_configuration
from tests.support.supernode.lone_node import LoneNode, acknowledgement, append

X = Member(member_id="x", address="x:1")


def vote_request(term: int, *, last: tuple[int, int] = (9, 9), pre_vote: bool = False) -> Message:
    return VoteRequest(term=term, last_log_index=last[0], last_log_term=last[1], pre_vote=pre_vote)


def locked_out(lone: LoneNode) -> None:
    """Let so much time pass without a leader that all members that the node knows may be gone."""
    lone.node.before_tick()
    lone.now += 2 * lone.node.locked_out_seconds
    lone.node.before_tick()
    lone.sent_messages()


@pytest.mark.parametrize(
    "message",
    [
        vote_request(TERMS_AHEAD_MAX + 1),
        vote_request(2**62, pre_vote=True),
        append(2**62, (1, 0), []),
        AppendReply(term=2**62, next_index=2, reset=False, success=False),
        VoteReply(term=0, pre_vote=True, voter_term=2**62),
        TimeoutNow(term=2**62),
    ],
    ids=lambda message: type(message).__name__,
)
def test_an_implausibly_high_term_is_not_adopted(message: Message) -> None:
    lone = LoneNode()
    with pytest.raises(PeerAtFault, match="b names term"):
        lone.receive("b", message)
    assert lone.node.term == 0
    assert "b" not in lone.log.promises


def test_elections_continue_from_the_last_adopted_term() -> None:
    lone = LoneNode()
    lone.receive("b", vote_request(TERMS_AHEAD_MAX))
    assert lone.node.term == TERMS_AHEAD_MAX
    [(to, reply)] = lone.receive("c", vote_request(TERMS_AHEAD_MAX + 1))
    assert (to, reply.term) == ("c", TERMS_AHEAD_MAX + 1)  # type: ignore[union-attr]
    lone.now += 100.0
    assert lone.lead() == TERMS_AHEAD_MAX + 2


def test_a_false_claim_to_lead_does_not_depose_the_leader() -> None:
    lone = LoneNode()
    term = lone.lead()
    with pytest.raises(PeerAtFault, match="but this member leads in that term"):
        lone.receive("b", append(term, (1, 0), []))
    assert lone.node.is_leader


def test_an_acknowledgement_beyond_the_end_of_the_log_is_ignored() -> None:
    lone = LoneNode()
    term = lone.lead()
    with pytest.raises(PeerAtFault, match="acknowledged up to 98, past 2"):
        lone.receive("b", acknowledgement(term, 99))
    lone.tick()
    assert (lone.node.is_leader, lone.node.commit_index) == (True, 1)


def test_a_caller_that_is_not_a_member_neither_votes_nor_deposes_the_leader() -> None:
    lone = LoneNode()
    term = lone.lead()
    lone.node.transport.deliver(NodeIntroduced("x", X))
    lone.node.transport.deliver(LinkConnected("x"))
    assert lone.receive("x", vote_request(term + 5)) == []
    assert lone.receive("x", append(term + 5, (1, 0), [])) == []
    assert (lone.node.is_leader, lone.node.term) == (True, term)
    assert "x" not in lone.node.peers


def test_a_member_without_a_known_leader_accepts_messages_of_unknown_members() -> None:
    lone = LoneNode()
    lone.node.transport.deliver(NodeIntroduced("x", X))
    locked_out(lone)
    assert "x" in lone.node.peers
    lone.node.transport.deliver(LinkConnected("x"))
    lone.receive("x", append(3, (1, 0), [(2, 3)]))
    lone.node.before_tick()
    assert lone.node.leader.id == "x"
    assert lone.held() == [(1, 0), (2, 3)]
    lone.receive("b", append(4, (2, 3), []))
    lone.node.before_tick()
    assert "x" not in lone.node.peers


def test_a_member_that_only_a_non_member_names_is_not_accepted() -> None:
    lone = LoneNode()
    lone.node.transport.deliver(NodeIntroduced("x", X))
    locked_out(lone)
    lone.node.transport.deliver(MembersReported("x", (Member(member_id="y", address="y:1"),)))
    lone.receive("b", append(4, (1, 0), []))
    lone.node.before_tick()
    assert set(lone.node.peers) == {"b", "c"}
    lone.node.transport.deliver(MembersReported("b", (X,)))
    assert set(lone.node.peers) == {"b", "c", "x"}


def test_a_node_remembers_only_a_few_unknown_members() -> None:
    lone = LoneNode()
    for number in range(1000):
        name = f"x{number}"
        lone.node.transport.deliver(NodeIntroduced(name, Member(member_id=name, address=f"{name}:1")))
    locked_out(lone)
    assert len(lone.node.peers) < 20
    assert {"b", "c"} <= set(lone.node.peers)


def test_many_hostile_promises_do_not_remove_the_promise_of_a_member() -> None:
    lone = LoneNode()
    lone.log.note_promise("b", 7, 70)
    for number in range(1000):
        lone.log.note_promise(f"x{number}", 9, 9)
    assert lone.log.promises["b"] == Promise(7, 70)
    assert len(lone.log.promises) <= 64


def test_a_node_whose_store_a_member_refuses_neither_votes_nor_becomes_a_candidate() -> None:
    lone = LoneNode()
    lone.node.on_disputed("b", "an older copy")
    assert lone.receive("c", vote_request(1, pre_vote=True)) == []
    assert lone.receive("c", vote_request(1)) == []
    lone.now += 100.0
    lone.node.before_tick()
    lone.tick()
    assert lone.node.role != CANDIDATE
    lone.node.on_disputed("b", "")
    assert [type(message) for _, message in lone.receive("c", vote_request(2))] == [VoteReply]


def test_a_refusal_by_a_non_member_has_no_effect() -> None:
    lone = LoneNode()
    lone.node.transport.deliver(NodeIntroduced("x", X))
    locked_out(lone)
    lone.node.on_disputed("x", "an older copy")
    assert lone.node.disputed_by == {}


def forwarded(lone: LoneNode, outcomes: list[bytes | ProposalFailure]) -> int:
    """Have the node forward a command to its leader; returns the id of the request."""
    lone.node.propose(b"command", outcomes.append)
    [(_, message)] = lone.tick()
    return int(message.request_id)


def taken(request_id: int, log_index: int) -> Message:
    return ForwardedCommandReply(request_id=request_id, log_index=log_index, log_term=1)


def test_only_the_leaders_answers_to_open_requests_count() -> None:
    lone, outcomes = LoneNode(), []  # type: LoneNode, list[bytes | ProposalFailure]
    lone.receive("b", append(1, (1, 0), []))
    request_id = forwarded(lone, outcomes)
    lone.receive("c", taken(request_id, 5))
    assert lone.node.callers_waiting_count() == 0
    lone.receive("b", taken(request_id, 5))
    assert lone.node.callers_waiting_count() == 1


def test_false_positions_of_a_leader_keep_a_bounded_number_of_callers_waiting() -> None:
    lone, outcomes = LoneNode(), []  # type: LoneNode, list[bytes | ProposalFailure]
    lone.receive("b", append(1, (1, 0), []))
    most = lone.node.conf.commandsQueueSize
    for number in range(most + 10):
        lone.receive("b", taken(forwarded(lone, outcomes), 1000 + number))
    assert lone.node.callers_waiting_count() == most
    assert outcomes == [ProposalFailure.UNKNOWN] * 10


def test_a_member_that_asks_repeatedly_waits_only_for_the_last_answer() -> None:
    lone = LoneNode()
    for number in range(1000):
        lone.node.transport.deliver(MessageReceived("b", ReadIndexRequest(request_id=number)))
    lone.node.reads.start_round()
    assert [message.request_id for _, message in lone.sent_messages()] == [999]


def test_a_hostile_leader_that_names_a_removed_member_again_stops_no_process() -> None:
    lone = LoneNode()
    ab, abc = (
        Configuration.of([Member(member_id=name, address=f"{name}:1") for name in names], retired)
        for names, retired in (("ab", "c"), ("abc", ""))
    )
    entries = [Entry(encode_configuration(one), index, 1) for index, one in enumerate((ab, abc), start=2)]
    first = append(1, (1, 0), [], commit=2)
    lone.receive("b", replace(first, entries=entries[:1]))
    lone.tick()
    lone.node.before_tick()
    assert set(lone.node.peers) == {"b"}
    lone.receive("b", replace(append(1, (2, 1), [], commit=2), entries=entries[1:]))
    lone.tick()
    assert lone.node.voter_ids() == {"b", "c"}
