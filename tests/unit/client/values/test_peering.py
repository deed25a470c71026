"""The private values of a peer, and the arguments that a queue's caller may give."""

from __future__ import annotations

import os

import pytest
from hypothesis import given
from hypothesis import strategies as any_of

from stampede_rt.errors import InvalidArgument, StampedeError, error_for
from stampede_rt.values.peering import ClockOffset, PeerIdentity
from stampede_rt.values.queueing import QueuePolicy, parse_queue_policy
from stampede_rt.wire.peers import clock_message, clock_offset
from stampede_rt.wire.queues import queue_policy_from_spec, queue_policy_to_spec


def test_the_same_proof_gives_the_same_peer_id() -> None:
    first, second = (PeerIdentity.parse("planner", "0123456789abcdef", os.urandom(48)) for _ in range(2))
    assert first == second
    assert (len(first.peer_id), len(first.proof)) == (16, 32)
    assert PeerIdentity.parse("planner", "another proof, as long", b"") != first
    assert PeerIdentity.parse("viewer", "0123456789abcdef", b"") != first


def test_without_a_proof_every_start_has_another_peer_id() -> None:
    first, second = (PeerIdentity.parse("planner", None, os.urandom(48)) for _ in range(2))
    assert first.peer_id != second.peer_id
    assert first.proof != second.proof


def test_a_policy_keeps_its_stated_and_its_unstated_fields() -> None:
    stated = parse_queue_policy(max_items=3, on_full="reject", lease="5s", dead_letter_queue_id=bytes(16))
    assert queue_policy_from_spec(queue_policy_to_spec(stated)) == stated
    assert queue_policy_from_spec(queue_policy_to_spec(QueuePolicy())) == QueuePolicy()


def test_an_error_names_its_queue_once() -> None:
    error = error_for("QUEUE_FULL", "it is full")
    error.concerning("queue", "work")
    error.concerning("queue", "work")
    assert (str(error), error.metadata) == ("queue 'work': it is full", {"queue": "work"})


def test_the_error_names_a_wrong_lease() -> None:
    with pytest.raises(InvalidArgument, match="lease is '2h'; give at most 1 h"):
        parse_queue_policy(lease="2h")
    assert isinstance(error_for("PEER_NOT_FOUND", "x"), StampedeError)


def test_a_clock_is_compared_with_the_time_halfway_through_the_call() -> None:
    """The peer calls at 5000 by its own clock. The two ways together take 600. The supernode waits 400, and then
    reads 4000 from its clock.
    """
    found = ClockOffset.measured(
        sent_unix_nano=5000, took_nanos=1000, told_unix_nano=4000, supernode="s1", held_nanos=400
    )
    assert found == ClockOffset(offset_nanos=1700, uncertainty_nanos=300, supernode="s1")


nanos = any_of.integers(0, 10**12)


@given(there=nanos, held=nanos, back=nanos, ahead=any_of.integers(-(10**18), 10**18))
def test_the_error_of_a_measured_offset_is_never_above_its_uncertainty(
    there: int, held: int, back: int, ahead: int
) -> None:
    sent = 10**18
    stated = sent - ahead + there + held
    found = ClockOffset.measured(
        sent_unix_nano=sent, took_nanos=there + held + back, told_unix_nano=stated, supernode="s1", held_nanos=held
    )
    assert abs(found.offset_nanos - ahead) <= found.uncertainty_nanos
    assert found.uncertainty_nanos <= (there + back + 1) // 2
    message = clock_message(found)
    assert message is not None
    assert clock_offset(message) == found
