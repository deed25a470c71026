"""A leader removes no member, itself included, unless it knows that a majority of the others is alive."""

from __future__ import annotations

import pytest

from stampede_rt_supernode.replication.interface import ChangeRefused, ChangeUnderWay, Member
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome, MemberChange
from stampede_rt_supernode.replication.rules.member_changes import MemberChanges
from stampede_rt_supernode.replication.wire.buffered_transport import LinkConnected, StreamOpened
from stampede_rt_supernode.replication.wire.messages import TimeoutNow
from tests.support.supernode.lone_node import LoneNode, acknowledgement

ALIVE_SECONDS = 2.0


class Leader(LoneNode):
    """Member `a` leads. Only the members that a test names have answered it in its term."""

    def __init__(self, *answering: str, size: int = 3) -> None:
        super().__init__(size=size)
        self.term = self.lead()
        self.changes = MemberChanges(
            self.node, lambda: self.now, lambda call: call(), round_seconds=1.0, alive_seconds=ALIVE_SECONDS
        )
        self.take_answers(*answering)

    def take_answers(self, *answering: str) -> None:
        for member_id in answering:
            self.receive(member_id, acknowledgement(self.term, self.node.log.last_index + 1))
        self.tick()
        self.changes.advance()

    def let_pass(self, seconds: float, *answering: str) -> None:
        self.now += seconds
        self.take_answers(*answering)

    def remove(self, member_id: str) -> list[ChangeOutcome]:
        outcomes: list[ChangeOutcome] = []
        self.changes.add(MemberChange(Member(member_id=member_id, address="any:1"), True, outcomes.append))
        return outcomes

    def has(self, member_id: str) -> bool:
        return self.node.configuration().find(member_id) is not None


@pytest.mark.parametrize("removed", ["a", "b"])
def test_a_new_leader_counts_only_members_that_have_answered_it_as_alive(removed: str) -> None:
    leader = Leader("b")  # `c` is down
    [outcome] = leader.remove(removed)
    assert isinstance(outcome, ChangeUnderWay)
    assert "has led for too short a time" in str(outcome)
    assert leader.has(removed)
    assert leader.changes.is_idle


@pytest.mark.parametrize("removed", ["a", "b"])
def test_a_leader_that_has_heard_from_all_members_refuses_the_removal_for_good(removed: str) -> None:
    leader = Leader("b")
    leader.let_pass(ALIVE_SECONDS, "b")
    [outcome] = leader.remove(removed)
    assert isinstance(outcome, ChangeRefused)
    assert f"without {removed} no majority" in str(outcome)
    assert leader.has(removed)
    assert leader.changes.is_idle


def test_a_new_leader_removes_a_member_as_soon_as_enough_members_have_answered() -> None:
    leader = Leader("b")
    leader.remove("b")
    leader.take_answers("c")
    outcomes = leader.remove("b")
    leader.take_answers("c")
    assert not leader.has("b")
    assert [type(outcome) for outcome in outcomes] == [int]


def test_a_member_that_is_down_can_be_removed_immediately() -> None:
    leader = Leader("b")
    leader.remove("c")
    assert not leader.has("c")


def test_a_leader_of_five_hands_over_for_its_removal_while_three_of_the_others_are_alive() -> None:
    leader = Leader("b", "c", size=5)
    assert isinstance(leader.remove("a")[0], ChangeUnderWay), "two of four are not a majority"
    leader.take_answers("d")
    assert leader.remove("a") == []
    assert leader.changes.hands_over


def test_the_leader_hands_over_to_a_member_that_has_answered_in_this_term() -> None:
    leader = Leader()
    leader.changes.hand_over(HandOver(lambda left: None))
    leader.changes.advance()
    assert not [message for _, message in leader.sent_messages() if isinstance(message, TimeoutNow)]
    leader.receive("c", acknowledgement(leader.term, leader.node.log.last_index + 1))
    leader.changes.advance()
    assert [to for to, message in leader.sent_messages() if isinstance(message, TimeoutNow)] == ["c"]


def test_a_new_member_that_fell_silent_becomes_a_voter_only_after_it_answers_again() -> None:
    leader = Leader("b", "c")
    leader.changes.add(MemberChange(Member(member_id="new", address="new:1"), False, lambda outcome: None))
    leader.node.transport.deliver(LinkConnected("new"))
    for member_id in ("b", "c", "new"):
        leader.node.transport.deliver(StreamOpened(member_id, leader.machine.highest_level))
    leader.receive("new", acknowledgement(leader.term, leader.node.log.last_index + 1))
    leader.let_pass(ALIVE_SECONDS, "b", "c")
    leader.take_answers("b", "c")
    assert not leader.has("new")
    leader.take_answers("new")
    leader.take_answers("b", "c", "new")
    assert leader.has("new")
