"""The directory gives a channel or queue away only with the owner's permit."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.access.move_permits import move_permit
from stampede_rt_supernode.core.cluster.feature_levels import MOVES_LEVEL
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.moves.commands import CommitMove, CommitQueueMove, MoveCommitted, QueueMoveCommitted
from tests.support.supernode.operations import Log, id_of, open_channel, open_queue, register

KEYS = {number: bytes([number]) * 32 for number in (1, 2, 3)}


@pytest.fixture
def log() -> Log:
    """Hosts 1 to 3 with keys; channel "cam" and queue "jobs" at host 1."""
    log = Log(level=MOVES_LEVEL)
    for number, key in KEYS.items():
        log.apply(register(number, move_key=key))
    log.apply(open_channel("cam", host="host-1"))
    log.apply(open_queue("jobs", host="host-1"))
    return log


def commit(log: Log, to: int, permit: bytes, epoch: int = 1, boot: int = 1) -> object:
    channel = log.directory.tables.channel_named("cam")
    assert channel is not None
    return log.apply(CommitMove(
        channel_id=channel.channel_id, epoch=epoch, to_host_id=id_of(to), to_boot_incarnation=boot, permit=permit
    ))  # fmt: skip


def permit_for(log: Log, to: int, epoch: int = 1, key: int = 1) -> bytes:
    channel = log.directory.tables.channel_named("cam")
    assert channel is not None
    return move_permit(KEYS[key], channel.channel_id, epoch, id_of(to))


def denied(done: object) -> bool:
    return isinstance(done, RefusedOperation) and done.reason == "PERMISSION_DENIED"


def test_the_host_with_the_permit_gets_the_channel(log: Log) -> None:
    assert isinstance(commit(log, 2, permit_for(log, 2)), MoveCommitted)
    assert isinstance(commit(log, 2, b""), MoveCommitted), "a repeated commit changes nothing"


def test_a_permit_of_one_host_moves_the_channel_to_no_other_host(log: Log) -> None:
    for permit in (b"", b"x", permit_for(log, 2), permit_for(log, 3, key=3), permit_for(log, 3, epoch=2)):
        assert denied(commit(log, 3, permit))
    owner = log.directory.tables.channel_named("cam")
    assert owner is not None
    assert (owner.host_id, owner.epoch) == (id_of(1), 1)


def test_the_owner_ends_a_move_without_a_permit_and_ends_its_permits_with_it(log: Log) -> None:
    permit = permit_for(log, 2)
    assert isinstance(commit(log, 1, b""), MoveCommitted)
    assert denied(commit(log, 2, permit, epoch=2))


def test_a_restarted_owner_has_another_key(log: Log) -> None:
    permit = permit_for(log, 2, epoch=2)
    log.apply(register(1, boot=2, move_key=b"n" * 32))
    assert denied(commit(log, 2, permit, epoch=2))


def test_an_owner_without_a_key_gives_no_permits(log: Log) -> None:
    """The owner registered with a directory that knew no permits."""
    log.apply(register(1, boot=2))
    assert isinstance(commit(log, 2, b"", epoch=2), MoveCommitted)


def test_below_the_level_of_moves_no_replica_keeps_a_key() -> None:
    """A supernode of an older release would not keep the key, and its state would differ."""
    log = Log()
    log.apply(register(1, move_key=KEYS[1]))
    assert log.directory.tables.hosts[id_of(1)].move_key == b""


def test_a_move_of_a_queue_also_needs_a_permit(log: Log) -> None:
    (queue_id,) = log.directory.tables.queues.by_id
    for permit, is_right in ((b"", False), (move_permit(KEYS[1], queue_id, 1, id_of(2)), True)):
        done = log.apply(CommitQueueMove(
            queue_id=queue_id, epoch=1, to_host_id=id_of(2), to_boot_incarnation=1, permit=permit
        ))  # fmt: skip
        assert isinstance(done, QueueMoveCommitted) if is_right else denied(done)


def test_a_key_of_another_length_is_refused(log: Log) -> None:
    done = log.apply(register(4, move_key=b"short"))
    assert isinstance(done, RefusedOperation)
    assert done.reason == "INVALID_ARGUMENT"
