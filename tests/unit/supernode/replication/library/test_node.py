"""The adapter that gives the library's node the names of the Raft paper."""

from __future__ import annotations

import pytest
from pysyncobj.config import FAIL_REASON

from stampede_rt_supernode.replication.library.node import LibraryNode, ProposalFailure
from stampede_rt_supernode.replication.wire.messages import (
    ForwardedCommand,
    ForwardedCommandReply,
    ForwardRefusal,
)
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.lone_node import LoneNode, append

NOT_TAKEN = ["QUEUE_FULL", "MISSING_LEADER", "DISCARDED", "NOT_LEADER"]
UNKNOWN = ["LEADER_CHANGED", "UNKNOWN_OUTCOME"]


@pytest.mark.parametrize(
    ("reason", "failure"),
    [(name, ProposalFailure.NOT_TAKEN) for name in NOT_TAKEN] + [(name, ProposalFailure.UNKNOWN) for name in UNKNOWN],
)
def test_every_failure_reason_of_the_library_maps_to_an_outcome_of_the_command(
    reason: str, failure: ProposalFailure
) -> None:
    lone, outcomes = LoneNode(), []
    lone.node._applyCommand = lambda command, callback, kind: callback(None, getattr(FAIL_REASON, reason))
    lone.node.propose(b"c", outcomes.append)
    assert outcomes == [failure]


def test_an_unexpected_failure_reason_stops_the_replica() -> None:
    lone = LoneNode()
    lone.node._applyCommand = lambda command, callback, kind: callback(None, FAIL_REASON.UNKNOWN_OUTCOME + 1)
    with pytest.raises(AssertionError, match="with reason 8"):
        lone.node.propose(b"c", lambda answer: None)


def test_every_private_name_that_the_adapter_uses_exists_in_the_library() -> None:
    node = LoneNode().node
    for name, alias in vars(LibraryNode).items():
        if hasattr(alias, "_name"):
            assert alias._name in vars(node), name


class OldMachine(ListMachine):
    """The state of a cluster whose feature level does not take any command yet."""

    def takes(self, command: bytes) -> bool:
        return False


def test_a_leader_answers_a_forwarded_command_that_its_state_machine_refuses() -> None:
    lone = LoneNode(machine=OldMachine())
    lone.lead()
    messages = lone.receive("b", ForwardedCommand(request_id=7, command=b"\x00new"))
    refusal = ForwardedCommandReply(request_id=7, refusal=ForwardRefusal.DENIED)
    assert ("b", refusal) in messages + lone.tick()


def test_a_forwarded_command_that_the_leader_refuses_is_certainly_not_in_the_log() -> None:
    lone, outcomes = LoneNode(), []
    lone.receive("b", append(1, (1, 0), []))
    lone.node.propose(b"new", outcomes.append)
    [(_, request)] = lone.tick()
    lone.receive("b", ForwardedCommandReply(request_id=request.request_id, refusal=ForwardRefusal.DENIED))
    assert outcomes == [ProposalFailure.NOT_TAKEN]
