"""Replicas of queues and mailboxes in the directory: who gets the queue when its host is lost, and after a move."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt_supernode.core.commands import Operation, RefusedOperation
from stampede_rt_supernode.core.moves.commands import CommitQueueMove
from stampede_rt_supernode.core.records import QueueRecord, ReplicaRecord
from stampede_rt_supernode.core.replicas.commands import ReplicaAdded, ReplicaInSyncSet
from tests.support.supernode.operations import (
    Log,
    add_replica,
    delete_queue,
    deregister,
    id_of,
    open_queue,
    register,
    register_peer,
    remove_replica,
    set_in_sync,
    update_queue,
)


@pytest.fixture
def log() -> Log:
    """Hosts 1 to 4; queue "jobs" at host 1, which waits for replicas."""
    log = Log()
    for number in (1, 2, 3, 4):
        log.apply(register(number))
    log.apply(open_queue("jobs", host="host-1", replicas=1, ack="replica"))
    return log


def jobs(log: Log) -> QueueRecord:
    found = log.directory.tables.queues.named("jobs")
    assert found is not None
    return found


def copies(log: Log, queue: QueueRecord | None = None) -> list[tuple[bytes, bool]]:
    held = log.directory.tables.replicas.of((queue or jobs(log)).queue_id)
    return [(one.host_id, one.in_sync) for one in held]


def add(log: Log, host: int, queue: QueueRecord | None = None) -> ReplicaRecord:
    """Add a replica in sync."""
    queue_id, epoch = (queue or jobs(log)).queue_id, (queue or jobs(log)).epoch
    operation = add_replica(queue_id, host, epoch=epoch, warm=True, acknowledged=True)
    added = log.apply(replace(operation, is_of_queue=True))
    assert isinstance(added, ReplicaAdded), added
    flag = replace(set_in_sync(queue_id, host, epoch=epoch), is_of_queue=True, change_number=7)
    assert isinstance(log.apply(flag), ReplicaInSyncSet)
    return added.replica


def reason(log: Log, operation: Operation) -> str:
    result = log.apply(operation)
    assert isinstance(result, RefusedOperation), result
    return result.reason


def test_a_replica_in_sync_gets_the_queue_with_its_incarnation(log: Log) -> None:
    add(log, 2)
    add(log, 3)
    before = jobs(log)
    log.apply(deregister(1))
    after = jobs(log)
    assert (after.host_id, after.epoch, after.incarnation) == (id_of(2), 2, before.incarnation)
    assert copies(log) == [(id_of(3), True)]


def test_a_restarted_host_loses_its_queue_to_the_replica(log: Log) -> None:
    add(log, 2)
    before = jobs(log)
    log.apply(register(1, boot=2))
    assert (jobs(log).host_id, jobs(log).incarnation) == (id_of(2), before.incarnation)


def test_a_queue_without_a_replica_in_sync_is_opened_anew(log: Log) -> None:
    add(log, 2)
    log.apply(replace(set_in_sync(jobs(log).queue_id, 2, False), is_of_queue=True, change_number=8))
    before = jobs(log)
    log.apply(deregister(1))
    assert jobs(log).host_id == id_of(1)
    log.apply(open_queue("jobs", incarnation=77))
    assert (jobs(log).host_id != id_of(1), jobs(log).incarnation != before.incarnation) == (True, True)
    assert not any(in_sync for _, in_sync in copies(log))


def test_a_mailbox_is_taken_over_by_its_replica(log: Log) -> None:
    log.apply(register_peer(7, name="planner", mailbox_host_name="host-1"))
    (mailbox,) = [one for one in log.directory.tables.queues.by_id.values() if one.mailbox_peer_id is not None]
    log.apply(update_queue(mailbox.queue_id, replicas=1, ack="replica"))
    add(log, 3, log.directory.tables.queues.by_id[mailbox.queue_id])
    log.apply(deregister(1))
    after = log.directory.tables.queues.by_id[mailbox.queue_id]
    assert (after.host_id, after.incarnation) == (id_of(3), mailbox.incarnation)


def test_after_a_move_to_a_replica_the_hosts_have_changed_places(log: Log) -> None:
    add(log, 2)
    queue = jobs(log)
    move = CommitQueueMove(queue_id=queue.queue_id, epoch=1, to_host_id=id_of(2), to_boot_incarnation=1)
    log.apply(move)
    assert (jobs(log).host_id, jobs(log).epoch, jobs(log).incarnation) == (id_of(2), 2, queue.incarnation)
    assert copies(log) == [(id_of(1), True)]


def test_a_new_owner_numbers_its_changes_of_the_in_sync_flags_from_1(log: Log) -> None:
    """The numbers are of the owner's own clock, which may be far behind the former owner's clock."""
    add(log, 2)
    add(log, 3)
    log.apply(deregister(1))
    clear = set_in_sync(jobs(log).queue_id, 3, False, epoch=jobs(log).epoch)
    assert isinstance(log.apply(replace(clear, is_of_queue=True, change_number=1)), ReplicaInSyncSet)
    assert copies(log) == [(id_of(3), False)]


def test_the_first_of_two_moves_of_a_queue_from_one_epoch_counts(log: Log) -> None:
    first = CommitQueueMove(queue_id=jobs(log).queue_id, epoch=1, to_host_id=id_of(2), to_boot_incarnation=1)
    log.apply(first)
    log.apply(first)
    assert reason(log, replace(first, to_host_id=id_of(3))) == "WRONG_EPOCH"
    assert (jobs(log).host_id, jobs(log).epoch) == (id_of(2), 2)


def test_a_replica_is_kept_after_a_move_to_another_host(log: Log) -> None:
    add(log, 2)
    move = CommitQueueMove(queue_id=jobs(log).queue_id, epoch=1, to_host_id=id_of(3), to_boot_incarnation=1)
    log.apply(move)
    assert copies(log) == [(id_of(2), True)]


def test_an_open_without_a_change_keeps_the_in_sync_flags(log: Log) -> None:
    add(log, 2)
    log.apply(open_queue("jobs"))
    (replica,) = log.directory.tables.replicas.of(jobs(log).queue_id)
    assert (replica.in_sync, replica.change_number) == (True, 7)


def test_a_queue_whose_acks_wait_for_no_replica_has_no_replicas(log: Log) -> None:
    add(log, 2)
    log.apply(update_queue(jobs(log).queue_id, replicas=0, ack="host"))
    assert copies(log) == []
    add_again = replace(add_replica(jobs(log).queue_id, 2, warm=True), is_of_queue=True)
    assert reason(log, add_again) == "INVALID_ARGUMENT"


def test_the_copies_of_a_deleted_queue_and_of_a_lost_host_are_removed(log: Log) -> None:
    add(log, 2)
    add(log, 3)
    log.apply(deregister(3))
    assert copies(log) == [(id_of(2), True)]
    queue_id = jobs(log).queue_id
    log.apply(replace(remove_replica(queue_id, 2), is_of_queue=True))
    add(log, 2)
    log.apply(delete_queue(queue_id))
    assert not log.directory.tables.replicas
    assert not log.directory.tables.replicas.channel_ids_at(id_of(2))


def test_an_invalid_copy_of_a_queue_is_refused(log: Log) -> None:
    queue_id = jobs(log).queue_id
    proxy = replace(add_replica(queue_id, 2), is_of_queue=True)
    warm = replace(add_replica(queue_id, 2, warm=True, acknowledged=True), is_of_queue=True)
    assert reason(log, proxy) == "INVALID_ARGUMENT"
    assert reason(log, replace(warm, channel_id=id_of(99))) == "QUEUE_NOT_FOUND"
    assert reason(log, replace(warm, is_of_queue=False)) == "CHANNEL_NOT_FOUND"
    assert reason(log, replace(warm, epoch=9)) == "WRONG_EPOCH"


@pytest.mark.parametrize(
    "spec",
    [
        {"ack": "replica"},
        {"replicas": 1},
        {"replicas": 1, "ack": "host"},
        {"replicas": 5, "ack": "replica"},
        {"replicas": 1, "ack": "replica", "min_replicas": 2},
    ],
)
def test_a_policy_whose_replicas_contradict_its_ack_is_refused(log: Log, spec: dict[str, int | str]) -> None:
    assert reason(log, open_queue("other", **spec)) == "INVALID_ARGUMENT"
