"""The releases that a leader lets in must know the present feature level and a proposed next level."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from stampede_rt_supernode.replication.interface import Member, ReleaseOutdated, too_old
from stampede_rt_supernode.replication.rules.member_change import ChangeOutcome, MemberChange
from stampede_rt_supernode.replication.rules.member_changes import MemberChanges
from stampede_rt_supernode.replication.wire.buffered_transport import LinkConnected, StreamOpened
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.lone_node import LoneNode, acknowledgement

NEWCOMER = Member(member_id="new", address="new:1")


class Leader(LoneNode):
    """Leads `a`, `b` and `c`. `b` and `c` have reported their levels. A newcomer is about to join."""

    def __init__(self, *, level: int, knows: int, reported_levels: Mapping[str, int]) -> None:
        machine = ListMachine()
        machine.feature_level, machine.highest_level = level, knows
        super().__init__(machine=machine)
        self.term = self.lead()
        for member_id, known in reported_levels.items():
            self.node.transport.deliver(StreamOpened(member_id, known))
        self.outcomes: list[ChangeOutcome] = []
        self.changes = MemberChanges(
            self.node, lambda: self.now, lambda call: call(), round_seconds=1.0, alive_seconds=2.0
        )
        self._all_acknowledge("b", "c")

    def _all_acknowledge(self, *member_ids: str) -> None:
        for member_id in member_ids:
            self.receive(member_id, acknowledgement(self.term, self.node.log.last_index + 1))
        self.tick()

    def let_in(self, knows: int | None) -> ChangeOutcome:
        """Let the newcomer join with the whole log. It has reported the level `knows`; None: it has reported none."""
        self.changes.add(MemberChange(NEWCOMER, False, self.outcomes.append))
        self.node.transport.deliver(LinkConnected(NEWCOMER.member_id))
        if knows is not None:
            self.node.transport.deliver(StreamOpened(NEWCOMER.member_id, knows))
        self._all_acknowledge(NEWCOMER.member_id)
        self.changes.advance()
        if not self.outcomes:
            self._all_acknowledge("b", "c", NEWCOMER.member_id)
            self.changes.advance()
        [outcome] = self.outcomes
        return outcome


@pytest.mark.parametrize(
    ("level", "members_know", "newcomer", "needed"),
    [
        (1, (1, 1, 1), 1, None),
        (1, (2, 1, 1), 1, None),
        (2, (2, 2, 2), 2, None),
        (2, (2, 2, 2), 3, None),
        (2, (2, 2, 2), 1, 2),
        (2, (3, 3, 2), 1, 2),
        (1, (2, 2, 2), 1, 2),
        (1, (3, 2, 3), 1, 2),
        (1, (1, 1, 1), None, 1),
    ],
)
def test_a_new_member_must_know_the_clusters_present_level_and_a_proposed_next_level(
    level: int, members_know: tuple[int, int, int], newcomer: int | None, needed: int | None
) -> None:
    own, b, c = members_know
    leader = Leader(level=level, knows=own, reported_levels={"b": b, "c": c})
    outcome = leader.let_in(newcomer)
    is_member = leader.node.configuration().find(NEWCOMER.member_id) is not None
    if needed is None:
        assert isinstance(outcome, int)
        assert is_member
    else:
        assert isinstance(outcome, ReleaseOutdated)
        assert str(outcome) == too_old(NEWCOMER.member_id, newcomer or 0, needed)
        assert not is_member
        assert leader.node.learner is None
        assert leader.changes.is_idle, "others can come"


def test_the_clusters_level_stays_and_older_releases_may_join_while_the_level_of_a_member_is_unknown() -> None:
    assert isinstance(Leader(level=1, knows=2, reported_levels={"b": 2}).let_in(1), int)
    assert isinstance(Leader(level=2, knows=2, reported_levels={"b": 2}).let_in(1), ReleaseOutdated)


def test_a_member_that_was_refused_for_its_release_joins_with_the_release_of_the_others() -> None:
    leader = Leader(level=2, knows=2, reported_levels={"b": 2, "c": 2})
    assert isinstance(leader.let_in(1), ReleaseOutdated)
    leader.outcomes.clear()
    assert isinstance(leader.let_in(2), int)
