"""The members whose state differs from the state of most members, and how a state without a digest gets one."""

from __future__ import annotations

import pytest

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.command_codec import encode_command
from stampede_rt_supernode.core.commands import Command, Operation
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.rules.digests import DigestPoll, Digests
from stampede_rt_supernode.replication.wire.messages import NO_DIGEST
from tests.support.supernode.operations import begin_tenure, id_of, open_channel, register

UNKNOWN = b"\xff\xff what this release does not know"
OPERATIONS = [begin_tenure(), register(1), open_channel("cam/1"), open_channel("cam/2"), open_channel("cam/3")]


def encoded(number: int, operation: Operation) -> bytes:
    return encode_command(Command(op_id=id_of(number), time_unix_nano=number, operation=operation))


COMMANDS = [encoded(number, operation) for number, operation in enumerate(OPERATIONS, start=1)]


class Follower:
    """A directory and its digests, as a node drives them."""

    def __init__(self, snapshot: bytes) -> None:
        self.replica = DirectoryReplica()
        self.replica.prepare_restore(snapshot)()
        self.digests = Digests(self.replica.adopt_digest)
        self.digests.note(*self.replica.digest())

    def apply(self, index: int, command: bytes) -> None:
        self.replica.apply(index, command)
        self.digests.note(*self.replica.digest())


def leader_at(index: int) -> DirectoryReplica:
    replica = DirectoryReplica()
    for at, command in enumerate(COMMANDS[:index], start=1):
        replica.apply(at, command)
    return replica


def snapshot_at(index: int, *, with_digest: bool) -> bytes:
    snapshot = pb.DirectorySnapshot.FromString(leader_at(index).begin_snapshot()())
    assert snapshot.digest
    if not with_digest:
        snapshot.ClearField("digest")
    return snapshot.SerializeToString()


def test_a_snapshot_with_a_digest_is_compared_at_its_last_position() -> None:
    follower = Follower(snapshot_at(2, with_digest=True))
    follower.digests.compare(2, b"another state's")
    assert (follower.digests.doubtful_at, follower.digests.diverged_at) == (2, 0)
    follower.digests.compare_with_majority(2, b"another state's")
    assert (follower.digests.doubtful_at, follower.digests.diverged_at) == (0, 2)


@pytest.mark.parametrize("ahead", [0, 1, 2])
def test_after_a_snapshot_without_a_digest_a_member_continues_from_the_leaders_digest(
    ahead: int,
) -> None:
    follower = Follower(snapshot_at(2, with_digest=False))
    assert follower.replica.digest() == (2, b"")
    follower.digests.compare(2 + ahead, leader_at(2 + ahead).digest()[1])
    for index in range(3, 6):
        follower.apply(index, COMMANDS[index - 1])
    assert follower.replica.digest() == leader_at(5).digest()
    follower.digests.compare(*leader_at(5).digest())
    assert follower.digests.diverged_at == 0
    restored = DirectoryReplica()
    restored.prepare_restore(follower.replica.begin_snapshot()())()
    assert restored.digest() == leader_at(5).digest(), "its own snapshots have a digest"


def test_a_difference_after_the_first_digest_is_found() -> None:
    follower = Follower(snapshot_at(2, with_digest=False))
    follower.digests.compare(*leader_at(2).digest())
    follower.apply(3, UNKNOWN)
    follower.digests.compare_with_majority(*leader_at(3).digest())
    assert follower.digests.diverged_at == 3


def test_a_digest_of_a_position_before_the_state_is_ignored() -> None:
    follower = Follower(snapshot_at(2, with_digest=False))
    follower.apply(3, COMMANDS[2])
    follower.digests.compare(*leader_at(2).digest())
    assert follower.replica.digest() == (3, b"")
    follower.digests.compare(3, b"")
    assert follower.replica.digest() == (3, b""), "the answer of a leader without a digest is ignored, too"
    follower.digests.compare(*leader_at(3).digest())
    assert follower.replica.digest() == leader_at(3).digest()
    assert follower.digests.diverged_at == 0


ONE, OTHER = b"one state", b"another one"


def polled(own_digest: bytes, answers: dict[str, bytes], *, voters: int) -> DigestPoll:
    """A leader's poll at position 7 among `voters` other voters, "a", "b", ..."""
    poll = DigestPoll()
    poll.ask(0.0, (7, own_digest), [])
    for name, digest in answers.items():
        poll.note_answer(name, (7, digest), "abcdef"[:voters])
    return poll


@pytest.mark.parametrize(
    ("answers", "voters", "of_most"),
    [
        ({}, 0, ONE),
        ({}, 1, b""),
        ({"a": OTHER}, 1, b""),
        ({"a": OTHER}, 2, b""),
        ({"a": OTHER, "b": OTHER}, 2, OTHER),
        ({"a": OTHER, "b": ONE}, 2, ONE),
        ({"a": OTHER, "b": OTHER}, 3, b""),
        ({"a": OTHER, "b": OTHER, "c": ONE}, 3, b""),
        ({"a": OTHER, "b": OTHER, "c": OTHER}, 3, OTHER),
        ({"a": OTHER, "b": OTHER, "x": OTHER}, 3, b""),
    ],
)
def test_the_state_of_a_majority_of_voters_counts_as_right_under_any_leader(
    answers: dict[str, bytes], voters: int, of_most: bytes
) -> None:
    assert polled(ONE, answers, voters=voters).majority_digest("abcdef"[:voters])[1] == of_most


def test_a_member_that_differs_from_the_leader_is_in_doubt_until_most_agree() -> None:
    poll = polled(ONE, {"a": OTHER}, voters=2)
    assert poll.doubts == {"a": 7}
    poll.note_answer("b", (7, ONE), "ab")
    assert poll.doubts == {}
    assert poll.ids_with_digest(OTHER) == ["a"]


def test_a_doubt_ends_when_its_member_is_removed_or_agrees() -> None:
    poll = polled(ONE, {"a": OTHER, "b": OTHER}, voters=3)
    assert poll.doubts == {"a": 7, "b": 7}
    poll.note_answer("b", (7, ONE), "bcd")
    assert poll.doubts == {}, "one member was removed, and the other one agrees now"


def test_a_leader_asks_for_a_digest_until_all_connected_members_answer_or_six_seconds_are_over() -> None:
    poll = DigestPoll()
    assert poll.majority_digest("ab") == NO_DIGEST
    poll.ask(0.0, (5, b""), "ab")
    assert poll.named_state == NO_DIGEST, "a leader without a digest names no position"
    poll.ask(0.0, (7, ONE), "ab")
    poll.ask(0.4, (8, ONE), [])
    assert poll.named_state == (7, ONE)
    poll.note_answer("a", (7, ONE), "ab")
    poll.note_answer("b", (6, OTHER), "ab")
    poll.ask(1.0, (9, ONE), "ab")
    assert poll.named_state == (7, ONE), "b has not come so far"
    poll.ask(1.0, (9, ONE), "a")
    assert poll.named_state == (9, ONE)
    poll.ask(5.9, (10, OTHER), "ab")
    assert poll.named_state == (9, ONE)
    poll.ask(6.0, (10, OTHER), "ab")
    assert poll.named_state == (10, OTHER)
    assert poll.majority_digest("ab") == NO_DIGEST, "those answers were about another position"


def test_a_member_sends_its_digest_once_it_has_reached_the_position_that_the_leader_named_last() -> None:
    digests = Digests(lambda digest: None)
    digests.note(5, ONE)
    digests.compare(7, ONE)
    assert digests.answer == NO_DIGEST
    digests.note(6, b"an earlier state")
    digests.note(7, OTHER)
    assert (digests.answer, digests.doubtful_at) == ((7, OTHER), 7)
    digests.compare_with_majority(7, OTHER)
    assert (digests.doubtful_at, digests.diverged_at) == (0, 0), "only the leader differs"
