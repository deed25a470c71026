"""One entry commits or releases several moves. Each of them succeeds or fails as if it were alone."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.moves.commands import (
    CommitMoves,
    MovesCommitted,
    MovesReleased,
    MoveToCommit,
    MoveToRelease,
    ReleaseMoves,
)
from stampede_rt_supernode.core.moves.several import MOVES_MAX, owners, released
from stampede_rt_supernode.core.records import ReplicaKind
from tests.support.supernode.operations import (
    Log,
    add_replica,
    delete,
    expire,
    id_of,
    open_channel,
    register,
    set_in_sync,
)

NAMES = ("a", "b", "c")


@pytest.fixture
def log() -> Log:
    """Hosts 1 to 3, and three channels at host 1."""
    log = Log()
    for number in (1, 2, 3):
        log.apply(register(number))
    for name in NAMES:
        log.apply(open_channel(name, host="host-1"))
    return log


def channel(log: Log, name: str) -> Any:
    found = log.directory.tables.channel_named(name)
    assert found is not None
    return found


def committed(log: Log, to: int, **epochs: int) -> list[str]:
    """Commit moves of these channels at these epochs. Returns the names of the committed ones."""
    moves = tuple(MoveToCommit(channel_id=channel(log, name).channel_id, epoch=epoch) for name, epoch in epochs.items())
    done = log.apply(CommitMoves(to_host_id=id_of(to), to_boot_incarnation=1, moves=moves))
    assert isinstance(done, MovesCommitted)
    assert all(one == channel(log, one.name) for one in done.channels)
    return [one.name for one in done.channels]


def free(log: Log, owner: int, **epochs: int) -> list[bytes]:
    moves = tuple(MoveToRelease(channel_id=channel(log, name).channel_id, epoch=one) for name, one in epochs.items())
    done = log.apply(ReleaseMoves(host_id=id_of(owner), moves=moves))
    assert isinstance(done, MovesReleased)
    return [*done.channel_ids]


def kinds(log: Log, name: str) -> list[tuple[ReplicaKind, bytes]]:
    return [(one.kind, one.host_id) for one in log.directory.tables.replicas.of(channel(log, name).channel_id)]


def test_each_move_of_an_entry_succeeds_or_fails_by_itself(log: Log) -> None:
    assert committed(log, 2, a=1, b=9, c=1) == ["a", "c"]
    assert [channel(log, name).host_id for name in NAMES] == [id_of(2), id_of(1), id_of(2)]
    assert kinds(log, "a") == [(ReplicaKind.MOVE, id_of(1))]
    assert (channel(log, "b").epoch, kinds(log, "b")) == (1, [])


def test_several_moves_that_are_committed_twice_happen_once(log: Log) -> None:
    assert committed(log, 2, a=1, b=1) == committed(log, 2, a=1, b=1) == ["a", "b"]
    assert channel(log, "a").epoch == 2


def test_no_move_to_a_lost_host_is_committed(log: Log) -> None:
    log.apply(expire(2, registered_index=3))
    assert committed(log, 2, a=1, b=1) == []


def test_a_release_removes_only_the_fallbacks_of_the_named_channels(log: Log) -> None:
    committed(log, 2, a=1, b=1, c=1)
    ids = [channel(log, name).channel_id for name in NAMES]
    assert free(log, 2, a=2, b=2) == ids[:2]
    assert released(log.directory.tables, id_of(1), ids) == ids[:2]
    log.apply(expire(2, registered_index=3))
    assert [channel(log, name).host_id for name in NAMES] == [id_of(2), id_of(2), id_of(1)]
    assert released(log.directory.tables, id_of(1), ids) == ids[:2], "the fallback of the third one is its owner again"


def test_only_the_owner_at_the_present_epoch_releases(log: Log) -> None:
    committed(log, 2, a=1, b=1)
    assert free(log, 3, a=2) == free(log, 2, a=1, b=3) == []
    assert kinds(log, "a") == [(ReplicaKind.MOVE, id_of(1))]


def test_a_release_does_not_remove_a_former_owner_that_is_a_replica(log: Log) -> None:
    channel_id = channel(log, "a").channel_id
    log.apply(add_replica(channel_id, 2, warm=True, acknowledged=True))
    log.apply(set_in_sync(channel_id, 2))
    committed(log, 2, a=1)
    assert free(log, 2, a=2) == [channel_id]
    assert kinds(log, "a") == [(ReplicaKind.WARM, id_of(1))]
    assert released(log.directory.tables, id_of(1), [channel_id]) == []


def test_a_deleted_channel_is_neither_committed_nor_released(log: Log) -> None:
    gone = channel(log, "a").channel_id
    log.apply(delete(gone))
    done = log.apply(CommitMoves(
        to_host_id=id_of(2), to_boot_incarnation=1, moves=(MoveToCommit(channel_id=gone, epoch=1),)
    ))  # fmt: skip
    assert done == MovesCommitted(channels=())
    assert released(log.directory.tables, id_of(1), [gone]) == []


@pytest.mark.parametrize("count", [0, MOVES_MAX + 1])
def test_an_entry_names_a_limited_number_of_channels(log: Log, count: int) -> None:
    ids = [id_of(one + 1) for one in range(count)]
    moves = tuple(MoveToCommit(channel_id=one, epoch=1) for one in ids)
    releases = tuple(MoveToRelease(channel_id=one, epoch=1) for one in ids)
    for done in (
        log.apply(CommitMoves(to_host_id=id_of(2), to_boot_incarnation=1, moves=moves)),
        log.apply(ReleaseMoves(host_id=id_of(2), moves=releases)),
    ):
        assert isinstance(done, RefusedOperation)
        assert f"names {count} channels; name 1 to 32" in done.message
    with pytest.raises(InvalidArgument):
        released(log.directory.tables, id_of(1), ids)


def test_the_owners_of_several_channels_are_named_once_and_unknown_channels_are_left_out(log: Log) -> None:
    committed(log, 2, a=1)
    ids = [channel(log, name).channel_id for name in NAMES]
    channels, hosts = owners(log.directory.tables, [*ids, id_of(99)])
    assert [one.channel_id for one in channels] == ids
    assert [one.host_id for one in hosts] == [id_of(2), id_of(1)]
    with pytest.raises(InvalidArgument):
        owners(log.directory.tables, [])
