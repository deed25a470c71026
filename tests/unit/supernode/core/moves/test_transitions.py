"""One entry gives a channel another owner. The former owner is the fallback until the new owner needs none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.moves.commands import CommitMove, MoveCommitted
from stampede_rt_supernode.core.records import ChannelRecord, ReplicaKind, ReplicaRecord
from tests.support.supernode.operations import (
    Log,
    add_replica,
    expire,
    id_of,
    open_channel,
    open_group,
    register,
    remove_replica,
    set_in_sync,
)


@pytest.fixture
def log() -> Log:
    """Hosts 1 to 3, registered at the log positions 2 to 4; channel "cam" at host 1."""
    log = Log()
    for number in (1, 2, 3):
        log.apply(register(number))
    log.apply(open_channel("cam", host="host-1"))
    return log


def cam(log: Log) -> ChannelRecord:
    found = log.directory.tables.channel_named("cam")
    assert found is not None
    return found


def move(log: Log, host: int, epoch: int, boot: int | None = None) -> ChannelRecord | RefusedOperation:
    done = log.apply(
        CommitMove(channel_id=cam(log).channel_id, epoch=epoch, to_host_id=id_of(host), to_boot_incarnation=boot or 1)
    )
    assert isinstance(done, MoveCommitted | RefusedOperation), done
    return done.channel if isinstance(done, MoveCommitted) else done


def copies(log: Log) -> tuple[ReplicaRecord, ...]:
    return log.directory.tables.replicas.of(cam(log).channel_id)


def reason(done: object) -> str:
    assert isinstance(done, RefusedOperation)
    return done.reason


def test_a_move_changes_owner_and_epoch_and_keeps_the_incarnation(log: Log) -> None:
    before = cam(log)
    assert move(log, 2, 1) == cam(log)
    assert (cam(log).host_id, cam(log).epoch, cam(log).incarnation) == (id_of(2), 2, before.incarnation)
    assert [(one.kind, one.host_id, one.in_sync) for one in copies(log)] == [(ReplicaKind.MOVE, id_of(1), True)]
    assert cam(log).proxy_host_ids == ()


def test_a_move_that_is_committed_twice_happens_once(log: Log) -> None:
    assert move(log, 2, 1) == move(log, 2, 1)
    assert cam(log).epoch == 2


def test_the_first_of_two_moves_from_one_epoch_counts(log: Log) -> None:
    move(log, 2, 1)
    assert reason(move(log, 3, 1)) == "WRONG_EPOCH"
    assert cam(log).host_id == id_of(2)


def test_the_owner_ends_a_move_by_an_epoch_of_its_own(log: Log) -> None:
    move(log, 1, 1)
    assert (cam(log).host_id, cam(log).epoch, copies(log)) == (id_of(1), 2, ())
    assert reason(move(log, 2, 1)) == "WRONG_EPOCH"


def test_a_destination_that_is_lost_or_has_restarted_cannot_commit(log: Log) -> None:
    assert reason(move(log, 2, 1, boot=77)) == "LEASE_EXPIRED"
    log.apply(expire(2, registered_index=3))
    assert reason(move(log, 2, 1)) == "HOST_NOT_FOUND"
    assert reason(move(log, 9, 1)) == "HOST_NOT_FOUND"
    assert cam(log).host_id == id_of(1)


def test_the_former_owner_continues_the_incarnation_if_the_new_owner_is_lost_immediately(log: Log) -> None:
    incarnation = cam(log).incarnation
    move(log, 2, 1)
    log.apply(expire(2, registered_index=3))
    assert (cam(log).host_id, cam(log).epoch, cam(log).incarnation) == (id_of(1), 3, incarnation)
    assert copies(log) == ()


@pytest.mark.parametrize("acknowledged", [True, False])
def test_a_former_owner_becomes_the_same_kind_of_replica_as_the_replaced_replica(log: Log, acknowledged: bool) -> None:
    before = cam(log)
    log.apply(add_replica(before.channel_id, 2, warm=True, acknowledged=acknowledged))
    log.apply(set_in_sync(before.channel_id, 2))
    move(log, 2, 1)
    assert [(one.host_id, one.in_sync, one.acknowledged) for one in copies(log)] == [(id_of(1), True, acknowledged)]
    log.apply(expire(2, registered_index=3))
    assert cam(log).host_id == id_of(1)
    # If puts do not wait for the former owner, it may lack acknowledged items.
    assert (cam(log).incarnation == before.incarnation) is acknowledged


def test_the_former_owner_comes_before_a_replica_if_the_new_owner_is_lost_immediately(log: Log) -> None:
    """The former owner has more channels than the replica's host, which the directory would choose otherwise."""
    log.apply(open_channel("other", host="host-1"))
    log.apply(add_replica(cam(log).channel_id, 3, warm=True, acknowledged=True))
    log.apply(set_in_sync(cam(log).channel_id, 3))
    move(log, 2, 1)
    log.apply(expire(2, registered_index=3))
    assert cam(log).host_id == id_of(1)


def test_the_former_owner_is_no_fallback_after_its_copy_is_removed(log: Log) -> None:
    move(log, 2, 1)
    log.apply(remove_replica(cam(log).channel_id, 1))
    log.apply(expire(2, registered_index=3))
    assert (cam(log).host_id, cam(log).epoch) == (id_of(2), 2)


def test_the_loss_of_the_former_owner_does_not_move_the_channel(log: Log) -> None:
    move(log, 2, 1)
    log.apply(expire(1, registered_index=2))
    assert (cam(log).host_id, copies(log)) == (id_of(2), ())


def test_the_new_owner_after_a_move_feeds_the_proxies_and_is_no_proxy_itself(log: Log) -> None:
    channel_id = cam(log).channel_id
    log.apply(add_replica(channel_id, 2))
    log.apply(add_replica(channel_id, 3, source=2))
    move(log, 2, 1)
    kinds = [(one.kind, one.host_id, one.source_host_id) for one in copies(log)]
    assert kinds == [(ReplicaKind.PROXY, id_of(3), id_of(2)), (ReplicaKind.MOVE, id_of(1), id_of(2))]
    assert cam(log).proxy_host_ids == (id_of(3),)


def test_the_groups_of_a_moved_channel_keep_their_incarnation_also_if_it_goes_back(log: Log) -> None:
    log.apply(open_group("both", [cam(log).channel_id]))
    before = log.directory.tables.groups.named("both")
    assert before is not None
    move(log, 2, 1)
    log.apply(expire(2, registered_index=3))
    after = log.directory.tables.groups.named("both")
    assert after is not None
    assert after.incarnation == before.incarnation


def test_a_commit_from_before_the_present_registration_of_its_host_does_not_count(log: Log) -> None:
    """The host may have dropped its copy, because the directory has refused a later attempt."""
    first = log.directory.tables.hosts[id_of(2)].registered_index
    commit = CommitMove(
        channel_id=cam(log).channel_id, epoch=1, to_host_id=id_of(2), to_boot_incarnation=1, to_registered_index=first
    )
    log.apply(expire(2, registered_index=first))
    assert reason(log.apply(commit)) == "HOST_NOT_FOUND"
    log.apply(register(2))
    assert reason(log.apply(commit)) == "LEASE_EXPIRED"
    second = log.directory.tables.hosts[id_of(2)].registered_index
    assert isinstance(log.apply(replace(commit, to_registered_index=second)), MoveCommitted)
    log.apply(register(2))
    assert isinstance(log.apply(commit), MoveCommitted), "a repeated commit changes nothing"
