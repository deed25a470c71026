"""The outcome of a command for its caller, for every answer of the library."""

from __future__ import annotations

from stampede_rt_supernode.replication.interface import LogUnavailable, OutcomeUnknown
from stampede_rt_supernode.replication.library.node import ProposalDone, ProposalFailure
from stampede_rt_supernode.replication.rules.proposals import Outcome, Proposal, Proposals


class Library:
    """Takes commands over, and answers when the test says."""

    def __init__(self, submitted_max: int = 10) -> None:
        self.handed: list[tuple[bytes, ProposalDone]] = []
        self.proposals = Proposals(
            lambda command, callback: self.handed.append((command, callback)),
            lambda finish: finish(),
            submitted_max=submitted_max,
        )
        self.outcomes: list[Outcome] = []

    def propose(self, command: bytes = b"c", deadline: float = 10.0) -> Proposal:
        proposal = Proposal(command, deadline, self.outcomes.append)
        self.proposals.add(proposal)
        return proposal

    def advance(self, now: float, *, leader: bool = True) -> None:
        self.proposals.advance(leader_reachable=leader, now=now)


def test_a_command_waits_for_a_leader_and_is_unavailable_if_none_is_elected() -> None:
    library = Library()
    library.propose()
    library.advance(1.0, leader=False)
    assert library.handed == []
    library.advance(10.0, leader=False)
    assert isinstance(library.outcomes[0], LogUnavailable)


def test_an_applied_command_gives_its_result() -> None:
    library = Library()
    library.propose()
    library.advance(1.0)
    library.handed[0][1](b"result")
    assert library.outcomes == [b"result"]


def test_a_command_that_was_certainly_not_accepted_is_tried_again_until_its_deadline() -> None:
    library = Library()
    library.propose()
    library.advance(1.0)
    library.handed[0][1](ProposalFailure.NOT_TAKEN)
    library.advance(2.0)
    assert len(library.handed) == 2
    library.handed[1][1](ProposalFailure.NOT_TAKEN)
    library.advance(10.0)
    assert [type(outcome) for outcome in library.outcomes] == [LogUnavailable]


def test_a_command_with_an_unknown_outcome_is_ambiguous_and_not_tried_again() -> None:
    library = Library()
    library.propose()
    library.advance(1.0)
    library.handed[0][1](ProposalFailure.UNKNOWN)
    library.advance(2.0)
    assert len(library.handed) == 1
    assert isinstance(library.outcomes[0], OutcomeUnknown)


def test_a_command_without_an_answer_is_ambiguous_at_its_deadline_and_makes_room() -> None:
    library = Library(submitted_max=1)
    library.propose()
    library.propose(b"next", deadline=20.0)
    library.advance(1.0)
    assert [command for command, _ in library.handed] == [b"c"]
    library.advance(10.0)
    assert isinstance(library.outcomes[0], OutcomeUnknown)
    assert [command for command, _ in library.handed] == [b"c", b"next"]
    library.handed[0][1](b"late")
    assert len(library.outcomes) == 1


def test_an_abandoned_command_is_never_submitted() -> None:
    library = Library()
    library.propose().abandoned = True
    library.advance(1.0)
    assert library.handed == []


def test_closing_ends_every_command_with_its_known_outcome() -> None:
    library = Library(submitted_max=1)
    library.propose()
    library.propose()
    library.advance(1.0)
    library.proposals.close()
    assert {type(outcome) for outcome in library.outcomes} == {OutcomeUnknown, LogUnavailable}
