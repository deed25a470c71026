"""A newcomer that makes a little progress again and again does not keep others from joining for ever."""

from __future__ import annotations

import pytest

from stampede_rt_supernode.replication.interface import ChangeUnderWay, Member
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome, MemberChange
from stampede_rt_supernode.replication.rules.member_changes import (
    JOIN_SECONDS_MAX,
    REPLACED_AFTER_SECONDS,
    MemberChanges,
)
from stampede_rt_supernode.replication.wire.buffered_transport import LinkConnected
from tests.support.supernode.lone_node import LoneNode, acknowledgement, command

SLOW, OTHER, THIRD = (Member(member_id=name, address=f"{name}:1") for name in ("slow", "other", "third"))


class Leader(LoneNode):
    """Leads `a`, `b` and `c`, with a log of 1000 entries; newcomers acknowledge as little as a test says."""

    def __init__(self) -> None:
        super().__init__()
        self.term = self.lead()
        for follower in ("b", "c"):
            self.receive(follower, acknowledgement(self.term, self.log.last_index + 1))
        self.tick()
        for number in range(1000):
            self.log.append(command(str(number)), self.log.last_index + 1, self.term)
        self.changes = MemberChanges(
            self.node, lambda: self.now, lambda call: call(), round_seconds=1.0, alive_seconds=2.0
        )
        self._acknowledged = 0

    def add(self, member: Member) -> list[ChangeOutcome]:
        outcomes: list[ChangeOutcome] = []
        self.changes.add(MemberChange(member, False, outcomes.append))
        self.node.transport.deliver(LinkConnected(member.member_id))
        return outcomes

    def let_pass(self, seconds: float, *, progress_of: Member) -> None:
        """The newcomer acknowledges one more entry every second."""
        for _ in range(int(seconds)):
            self.now += 1.0
            self._acknowledged += 1
            self.receive(progress_of.member_id, acknowledgement(self.term, self._acknowledged + 1))
            self.changes.advance()


@pytest.fixture
def leader() -> Leader:
    return Leader()


def test_a_slow_new_member_is_refused_with_the_reason_after_a_total_time(leader: Leader) -> None:
    outcomes = leader.add(SLOW)
    leader.let_pass(JOIN_SECONDS_MAX, progress_of=SLOW)
    assert not outcomes
    leader.let_pass(1, progress_of=SLOW)
    [outcome] = outcomes
    assert isinstance(outcome, ChangeUnderWay)
    assert "slow:1 has not caught up with the log within 600 s; give it a faster link or disk" in str(outcome)
    assert leader.changes.is_idle


def test_a_new_member_that_was_refused_as_too_slow_makes_room_for_another(
    leader: Leader,
) -> None:
    leader.add(SLOW)
    leader.let_pass(2 * REPLACED_AFTER_SECONDS, progress_of=SLOW)
    [refused] = leader.add(OTHER)
    assert "slow is joining" in str(refused), "the newcomer makes progress, and has time left"
    leader.let_pass(JOIN_SECONDS_MAX, progress_of=SLOW)
    second_add = leader.add(SLOW)
    leader.let_pass(3, progress_of=SLOW)
    assert not leader.add(OTHER)
    [outcome] = second_add
    assert "other joins instead of slow at slow:1, which did not catch up with the log at its last try" in str(outcome)
    [refused] = leader.add(THIRD)
    assert "other is joining" in str(refused), "the other newcomer has the whole time"
