"""A state from a snapshot without a digest: it goes on from the leader's, and is compared from there on."""

from __future__ import annotations

import pytest

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.command_codec import encode_command
from stampede_rt_supernode.core.commands import Command, Operation
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.rules.digests import Digests
from tests.unit.supernode.operations import begin_tenure, id_of, open_channel, register

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


def test_a_snapshot_of_this_release_is_compared_where_it_ends() -> None:
    follower = Follower(snapshot_at(2, with_digest=True))
    follower.digests.told(2, b"another state's")
    assert follower.digests.diverged_at == 2


@pytest.mark.parametrize("ahead", [0, 1, 2])
def test_a_state_from_a_snapshot_without_a_digest_goes_on_from_the_leaders_and_has_the_same_one_then(
    ahead: int,
) -> None:
    follower = Follower(snapshot_at(2, with_digest=False))
    assert follower.replica.digest() == (2, b"")
    follower.digests.told(2 + ahead, leader_at(2 + ahead).digest()[1])
    for index in range(3, 6):
        follower.apply(index, COMMANDS[index - 1])
    assert follower.replica.digest() == leader_at(5).digest()
    follower.digests.told(*leader_at(5).digest())
    assert follower.digests.diverged_at == 0
    restored = DirectoryReplica()
    restored.prepare_restore(follower.replica.begin_snapshot()())()
    assert restored.digest() == leader_at(5).digest(), "its own snapshots carry one"


def test_what_differs_after_the_first_digest_that_follows_is_found() -> None:
    follower = Follower(snapshot_at(2, with_digest=False))
    follower.digests.told(*leader_at(2).digest())
    follower.apply(3, UNKNOWN)
    follower.digests.told(*leader_at(3).digest())
    assert follower.digests.diverged_at == 3


def test_a_digest_of_where_the_state_is_no_more_is_not_taken_over() -> None:
    follower = Follower(snapshot_at(2, with_digest=False))
    follower.apply(3, COMMANDS[2])
    follower.digests.told(*leader_at(2).digest())
    assert follower.replica.digest() == (3, b"")
    follower.digests.told(3, b"")
    assert follower.replica.digest() == (3, b""), "nor that of a leader that knows none"
    follower.digests.told(*leader_at(3).digest())
    assert follower.replica.digest() == leader_at(3).digest()
    assert follower.digests.diverged_at == 0
