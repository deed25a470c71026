"""The commands of replicas and proxies, in a directory in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.cluster.commands import RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import CALLERS_FACTS_LEVEL
from stampede_rt_supernode.core.commands import Operation, RefusedOperation
from stampede_rt_supernode.core.records import ChannelRecord, ReplicaKind, ReplicaRecord
from stampede_rt_supernode.core.replicas import transitions as replica_transitions
from stampede_rt_supernode.core.replicas.commands import ReplicaAdded, ReplicaInSyncSet, ReplicaRemoved
from stampede_rt_supernode.core.replicas.loads import LOAD_AGE_NANOS_MAX, ReplicaLoad, ReplicaLoads
from tests.support.supernode.operations import (
    Log,
    add_replica,
    delete,
    deregister,
    expire,
    id_of,
    open_channel,
    register,
    remove_replica,
    set_in_sync,
    update,
)


@pytest.fixture
def log() -> Log:
    """Hosts 1 to 4, registered at the log positions 2 to 5; channel "cam" at host 1."""
    log = Log()
    for number in (1, 2, 3, 4):
        log.apply(register(number))
    log.apply(open_channel("cam", host="host-1"))
    return log


def cam(log: Log) -> ChannelRecord:
    found = log.directory.tables.channel_named("cam")
    assert found is not None
    return found


def copies(log: Log) -> tuple[ReplicaRecord, ...]:
    return log.directory.tables.replicas.of(cam(log).channel_id)


def added(log: Log, operation: Operation) -> ReplicaRecord:
    result = log.apply(operation)
    assert isinstance(result, ReplicaAdded), result
    return result.replica


def refusal(log: Log, operation: Operation) -> RefusedOperation:
    result = log.apply(operation)
    assert isinstance(result, RefusedOperation)
    return result


def warm_in_sync(log: Log, host: int, *, acknowledged: bool = True) -> None:
    added(log, add_replica(cam(log).channel_id, host, warm=True, acknowledged=acknowledged))
    assert isinstance(log.apply(set_in_sync(cam(log).channel_id, host)), ReplicaInSyncSet)


def test_a_copy_is_added_once_and_the_channel_names_its_host(log: Log) -> None:
    channel_id = cam(log).channel_id
    first = added(log, add_replica(channel_id, 2))
    assert added(log, add_replica(channel_id, 2)) == first
    assert (first.kind, first.source_host_id, first.boot_incarnation) == (ReplicaKind.PROXY, id_of(1), 1)
    assert cam(log).proxy_host_ids == (id_of(2),)
    assert cam(log).epoch == 1


def test_the_directory_chooses_the_host_with_the_fewest_channels_and_copies(log: Log) -> None:
    log.apply(open_channel("mic", host="host-2"))
    channel_id = cam(log).channel_id
    chosen = [added(log, add_replica(channel_id)).host_id for _ in range(3)]
    assert chosen == [id_of(3), id_of(4), id_of(2)]
    assert refusal(log, add_replica(channel_id)).reason == "NO_HOST"


def test_an_invalid_copy_of_a_channel_is_refused(log: Log) -> None:
    channel_id = cam(log).channel_id
    added(log, add_replica(channel_id, 2))
    for operation, reason in (
        (add_replica(id_of(99), 3), "CHANNEL_NOT_FOUND"),
        (add_replica(channel_id, 3, epoch=2), "WRONG_EPOCH"),
        (add_replica(channel_id, 9), "HOST_NOT_FOUND"),
        (add_replica(channel_id, 1), "CHANNEL_EXISTS"),
        (add_replica(channel_id, 2, warm=True), "CHANNEL_EXISTS"),
        (add_replica(channel_id, 3, source=4), "INVALID_ARGUMENT"),
        (add_replica(channel_id, 3, source=2, warm=True), "INVALID_ARGUMENT"),
        (add_replica(channel_id, 3, acknowledged=True), "INVALID_ARGUMENT"),
    ):
        assert refusal(log, operation).reason == reason, operation


def test_a_refusal_of_a_copy_names_the_host(log: Log) -> None:
    """In an earlier version, the error had the id of the host, which no command prints."""
    channel_id = cam(log).channel_id
    assert "host host-4 holds no proxy" in refusal(log, add_replica(channel_id, 3, source=4)).message
    log.apply(expire(2, registered_index=3))
    assert "host host-2 cannot hold a copy" in refusal(log, add_replica(channel_id, 2)).message
    assert id_of(9).hex() in refusal(log, add_replica(channel_id, 9)).message


def test_a_channel_has_a_bounded_number_of_copies(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replica_transitions, "REPLICAS_MAX", 1)
    added(log, add_replica(cam(log).channel_id, 2))
    refused = refusal(log, add_replica(cam(log).channel_id, 3))
    assert (refused.reason, refused.metadata["channel"]) == ("INVALID_ARGUMENT", "cam")


def test_the_copies_that_a_removed_proxy_fed_are_fed_by_the_owner(log: Log) -> None:
    channel_id = cam(log).channel_id
    added(log, add_replica(channel_id, 2))
    assert added(log, add_replica(channel_id, 3, source=2)).source_host_id == id_of(2)
    assert log.apply(remove_replica(channel_id, 2)) == ReplicaRemoved()
    assert [(one.host_id, one.source_host_id) for one in copies(log)] == [(id_of(3), id_of(1))]
    assert log.apply(remove_replica(channel_id, 2)) == ReplicaRemoved(), "an absent replica is not an error"
    assert cam(log).proxy_host_ids == (id_of(3),)


def test_the_owner_of_the_present_epoch_sets_the_in_sync_flag_for_one_boot_of_the_copys_host(log: Log) -> None:
    channel_id = cam(log).channel_id
    added(log, add_replica(channel_id, 2, warm=True))
    added(log, add_replica(channel_id, 3))
    done = log.apply(set_in_sync(channel_id, 2))
    assert isinstance(done, ReplicaInSyncSet)
    assert done.replica.in_sync
    for operation, reason in (
        (set_in_sync(channel_id, 2, False, epoch=2), "WRONG_EPOCH"),
        (set_in_sync(channel_id, 2, False, boot=2), "HOST_NOT_FOUND"),
        (set_in_sync(channel_id, 4), "HOST_NOT_FOUND"),
        (set_in_sync(channel_id, 3), "INVALID_ARGUMENT"),
        (set_in_sync(id_of(99), 2), "CHANNEL_NOT_FOUND"),
    ):
        assert refusal(log, operation).reason == reason, operation
    assert copies(log)[0].in_sync


ENDINGS: dict[str, Callable[[int], Operation]] = {
    "expired": lambda number: expire(number, registered_index=number + 1),
    "left": deregister,
    "restarted": lambda number: register(number, boot=2),
}


@pytest.mark.parametrize("end", ENDINGS.values(), ids=ENDINGS)
def test_a_warm_replica_in_sync_takes_over_when_the_owners_registration_ends(
    log: Log, end: Callable[[int], Operation]
) -> None:
    before = cam(log)
    warm_in_sync(log, 2)
    added(log, add_replica(before.channel_id, 3))
    log.apply(end(1))
    after = cam(log)
    assert (after.host_id, after.epoch, after.incarnation) == (id_of(2), 2, before.incarnation)
    assert after.proxy_host_ids == (id_of(3),)
    assert [(one.source_host_id, one.epoch) for one in copies(log)] == [(id_of(2), 2)]
    assert log.directory.tables.hosts[id_of(2)].channels == 1
    late = refusal(log, set_in_sync(before.channel_id, 2, False))
    assert late.reason == "WRONG_EPOCH", "the former owner cannot acknowledge without the replica any more"


def test_a_replica_for_which_no_put_waits_takes_over_with_a_new_incarnation(log: Log) -> None:
    before = cam(log)
    warm_in_sync(log, 2, acknowledged=False)
    warm_in_sync(log, 3)
    log.apply(deregister(1))
    assert (cam(log).host_id, cam(log).incarnation) == (id_of(2), before.incarnation + 1)
    assert [one.in_sync for one in copies(log)] == [False]


@pytest.mark.parametrize("end", [ENDINGS["expired"], ENDINGS["left"]], ids=["expired", "left"])
def test_a_replica_that_is_not_in_sync_never_takes_over(log: Log, end: Callable[[int], Operation]) -> None:
    warm_in_sync(log, 2)
    log.apply(set_in_sync(cam(log).channel_id, 2, False))
    added(log, add_replica(cam(log).channel_id, 3))
    log.apply(end(1))
    assert (cam(log).host_id, cam(log).epoch) == (id_of(1), 1)
    late = refusal(log, set_in_sync(cam(log).channel_id, 2))
    assert late.reason == "HOST_NOT_FOUND", "a host without a lease is no owner, so it cannot set the flag"


@pytest.mark.parametrize("end", ENDINGS.values(), ids=ENDINGS)
def test_a_copy_is_removed_with_the_registration_of_its_host(log: Log, end: Callable[[int], Operation]) -> None:
    warm_in_sync(log, 2)
    added(log, add_replica(cam(log).channel_id, 3))
    log.apply(end(2))
    assert [one.host_id for one in copies(log)] == [id_of(3)]
    assert cam(log).proxy_host_ids == (id_of(3),)
    log.apply(expire(1, registered_index=2))
    assert cam(log).host_id == id_of(1), "there is no replica to take over"


def test_a_change_of_the_in_sync_flag_that_arrives_after_a_later_one_is_refused(log: Log) -> None:
    warm_in_sync(log, 2)
    channel_id = cam(log).channel_id
    log.apply(replace(set_in_sync(channel_id, 2, False), change_number=7))
    log.apply(replace(set_in_sync(channel_id, 2, False), change_number=7))
    late = refusal(log, replace(set_in_sync(channel_id, 2), change_number=6))
    assert late.metadata["field"] == "change_number"
    assert [one.in_sync for one in copies(log)] == [False]


def test_a_late_flag_of_a_removed_replica_does_not_count_for_the_replica_that_was_added_afterwards(log: Log) -> None:
    """In an earlier version the replica without the items came in sync, and became the owner with the same
    incarnation.
    """
    log.apply(RaiseFeatureLevel(feature_level=CALLERS_FACTS_LEVEL))
    channel_id = cam(log).channel_id
    log.apply(update(channel_id, 1, replicas=1, ack="replica"))
    replica = added(log, add_replica(channel_id, 2, warm=True, acknowledged=True))
    flag = replace(set_in_sync(channel_id, 2), change_number=7, added_index=replica.added_index)
    log.apply(remove_replica(channel_id, 2))
    second = added(log, add_replica(channel_id, 2, warm=True, acknowledged=True))
    assert refusal(log, flag).metadata["field"] == "added_index"
    assert [one.in_sync for one in copies(log)] == [False]
    assert isinstance(log.apply(replace(flag, added_index=second.added_index)), ReplicaInSyncSet)


def test_a_former_owner_removes_no_replica_of_its_successor(log: Log) -> None:
    log.apply(RaiseFeatureLevel(feature_level=CALLERS_FACTS_LEVEL))
    log.apply(update(cam(log).channel_id, 1, replicas=2, ack="replica"))
    warm_in_sync(log, 2)
    warm_in_sync(log, 3)
    channel_id, former = cam(log).channel_id, cam(log)
    log.apply(expire(1, registered_index=2))
    left = 5 - int.from_bytes(cam(log).host_id, "big")  # the other one of the hosts 2 and 3
    late = refusal(log, replace(remove_replica(channel_id, left), epoch=former.epoch))
    assert late.reason == "WRONG_EPOCH"
    assert [one.host_id for one in copies(log)] == [id_of(left)]
    assert log.apply(replace(remove_replica(channel_id, left), epoch=cam(log).epoch)) == ReplicaRemoved()


def test_a_replica_is_refused_if_it_contradicts_the_ack_of_the_policy(log: Log) -> None:
    """The owner may not know the latest policy yet. In an earlier version such a replica stayed until the owner's next
    list.
    """
    log.apply(RaiseFeatureLevel(feature_level=CALLERS_FACTS_LEVEL))
    channel_id = cam(log).channel_id
    for ack in ("host", "replica"):
        log.apply(update(channel_id, 1, replicas=1, ack=ack))
        operation = add_replica(channel_id, 2, warm=True, acknowledged=ack != "replica")
        refused = refusal(log, operation)
        assert (refused.reason, refused.metadata["field"]) == ("INVALID_ARGUMENT", "acknowledged")
        assert refusal(log, replace(operation, epoch=7)).reason == "WRONG_EPOCH"
        assert copies(log) == ()
        assert added(log, replace(operation, acknowledged=ack == "replica")).acknowledged is (ack == "replica")


@pytest.mark.parametrize("ack", ["host", "replica"])
def test_a_caller_without_the_epoch_removes_no_replica_on_which_the_owner_counts(log: Log, ack: str) -> None:
    """In an earlier version the owner acknowledged puts by this replica until its next list, for up to 10 s."""
    log.apply(RaiseFeatureLevel(feature_level=CALLERS_FACTS_LEVEL))
    channel_id = cam(log).channel_id
    log.apply(update(channel_id, 1, replicas=1, ack=ack))
    warm_in_sync(log, 2, acknowledged=ack == "replica")
    assert log.apply(remove_replica(channel_id, 2)) == ReplicaRemoved()
    assert [one.in_sync for one in copies(log)] == [True]
    log.apply(set_in_sync(channel_id, 2, False))
    assert log.apply(remove_replica(channel_id, 2)) == ReplicaRemoved()
    assert copies(log) == ()


def test_below_the_level_replicas_ignore_the_facts_that_a_caller_knows(log: Log) -> None:
    channel_id = cam(log).channel_id
    replica = added(log, add_replica(channel_id, 2, warm=True, acknowledged=True))
    assert replica.added_index == 0
    assert isinstance(log.apply(replace(set_in_sync(channel_id, 2), added_index=99)), ReplicaInSyncSet)
    assert log.apply(replace(remove_replica(channel_id, 2), epoch=99)) == ReplicaRemoved()


def test_replicas_are_removed_when_the_ack_of_the_channel_begins_or_ceases_to_need_them(log: Log) -> None:
    added(log, add_replica(cam(log).channel_id, 3))
    for replicas, ack in ((1, "replica"), (0, "host")):
        warm_in_sync(log, 2)
        log.apply(update(cam(log).channel_id, 1, replicas=replicas, ack=ack))
        assert [one.host_id for one in copies(log)] == [id_of(3)]
        assert cam(log).proxy_host_ids == (id_of(3),)


def test_a_channel_with_replicas_0_removes_replicas_for_which_no_put_waits(log: Log) -> None:
    log.apply(update(cam(log).channel_id, 1, replicas=1))
    warm_in_sync(log, 2, acknowledged=False)
    added(log, add_replica(cam(log).channel_id, 3))
    log.apply(update(cam(log).channel_id, 1, max_items=5))
    assert len(copies(log)) == 2
    log.apply(update(cam(log).channel_id, 1, replicas=0))
    assert [one.kind for one in copies(log)] == [ReplicaKind.PROXY]


def test_a_late_expiry_moves_no_channel(log: Log) -> None:
    warm_in_sync(log, 2)
    log.apply(register(1))
    log.apply(expire(1, registered_index=2))
    assert (cam(log).host_id, cam(log).epoch) == (id_of(1), 1)


def test_the_successor_is_the_replica_at_the_host_with_the_fewest_channels(log: Log) -> None:
    log.apply(open_channel("mic", host="host-2"))
    warm_in_sync(log, 2)
    warm_in_sync(log, 3)
    log.apply(deregister(1))
    assert cam(log).host_id == id_of(3)
    assert [(one.host_id, one.in_sync) for one in copies(log)] == [(id_of(2), True)]


def test_a_channel_that_is_placed_on_the_host_of_a_copy_has_no_copy_there(log: Log) -> None:
    added(log, add_replica(cam(log).channel_id, 2))
    added(log, add_replica(cam(log).channel_id, 3, source=2))
    log.apply(deregister(1))
    opened = log.apply(open_channel("cam", host="host-2"))
    assert isinstance(opened, ChannelOpened)
    assert opened.channel == cam(log)
    assert (opened.channel.host_id, opened.channel.proxy_host_ids) == (id_of(2), (id_of(3),))
    assert copies(log)[0].source_host_id == id_of(2)


def test_a_deleted_channel_has_no_copies(log: Log) -> None:
    channel_id = cam(log).channel_id
    added(log, add_replica(channel_id, 2))
    log.apply(delete(channel_id))
    assert not log.directory.tables.replicas
    assert refusal(log, remove_replica(channel_id, 2)).reason == "CHANNEL_NOT_FOUND"


def load(host: int, *, bytes_per_second: int = 0, subscriptions: int = 0) -> ReplicaLoad:
    return ReplicaLoad(
        channel_id=id_of(9),
        host_id=id_of(host),
        subscriptions=subscriptions,
        delivered_bytes_per_second=bytes_per_second,
        next_seq=1,
        lag_nanos=0,
    )


def test_copies_are_listed_by_load_and_their_loads_end_with_time_and_tenure() -> None:
    loads, hosts = ReplicaLoads(), [id_of(1), id_of(2), id_of(3)]
    loads.lead(1)
    loads.note([load(1, bytes_per_second=5), load(2, subscriptions=2), load(3, subscriptions=1)], 0)
    assert [one.host_id for one in loads.of(id_of(9), hosts, 1)] == [id_of(3), id_of(2), id_of(1)]
    assert [one.host_id for one in loads.of(id_of(9), hosts[:1], 1)] == hosts[:1]
    loads.note([load(1)], LOAD_AGE_NANOS_MAX)
    assert [one.host_id for one in loads.of(id_of(9), hosts, LOAD_AGE_NANOS_MAX + 1)] == hosts[:1]
    loads.lead(2)
    assert loads.of(id_of(9), hosts, LOAD_AGE_NANOS_MAX + 1) == []
