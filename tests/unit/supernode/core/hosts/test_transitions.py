"""The commands of hosts, in a directory in memory."""

from dataclasses import replace

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.cluster.commands import TenureBegun
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.hosts import transitions
from stampede_rt_supernode.core.hosts.commands import HostDeregistered, HostExpired, HostRegistered, RegisterHost
from stampede_rt_supernode.core.queries import host_page
from stampede_rt_supernode.core.records import ChannelRecord, Endpoint, HostRecord
from tests.support.supernode.operations import Log, begin_tenure, deregister, expire, id_of, open_channel, register


@pytest.fixture
def log() -> Log:
    return Log()


def registered(log: Log, operation: RegisterHost) -> HostRecord:
    result = log.apply(operation)
    assert isinstance(result, HostRegistered), result
    return result.host


def channel_at(log: Log, host: str, name: str) -> ChannelRecord:
    result = log.apply(open_channel(name, host=host))
    assert isinstance(result, ChannelOpened)
    return result.channel


def now(log: Log, channel: ChannelRecord) -> ChannelRecord:
    return log.directory.tables.channels[channel.channel_id]


def test_no_host_can_register_before_the_cluster_is_founded() -> None:
    log = Log(founded=False)
    result = log.apply(register(1))
    assert isinstance(result, RefusedOperation)
    assert result.reason == "NO_QUORUM"
    log.apply(begin_tenure(1))
    registered(log, register(1))


def test_registering_answers_with_the_host_and_the_cluster(log: Log) -> None:
    result = log.apply(register(1))
    assert isinstance(result, HostRegistered)
    assert (result.host.alive, result.host.channels, result.cluster_id) == (True, 0, "c1")


def test_a_new_boot_raises_epoch_and_incarnation_of_all_its_channels_in_one_entry(log: Log) -> None:
    registered(log, register(1, name="one", boot=1))
    mine = [channel_at(log, "one", f"cam/{number}") for number in range(3)]
    registered(log, register(2, name="two"))
    other = channel_at(log, "two", "other")
    host = registered(log, register(1, name="one", boot=2, incarnation=4242))
    for channel in mine:
        assert (now(log, channel).epoch, now(log, channel).incarnation) == (channel.epoch + 1, 4242)
    assert now(log, other) == other
    assert host.channels == 3


def test_a_registration_with_the_same_boot_id_does_not_change_the_channels(log: Log) -> None:
    first = registered(log, register(1, name="one"))
    channel = channel_at(log, "one", "cam")
    log.apply(expire(1, registered_index=first.registered_index))
    repeated = registered(log, register(1, name="one"))
    assert repeated.alive
    assert now(log, channel) == channel


def test_a_name_belongs_to_one_live_host_at_a_time(log: Log) -> None:
    registered(log, register(1, name="rig"))
    result = log.apply(register(2, name="rig"))
    assert isinstance(result, RefusedOperation)
    assert result.reason == "HOST_EXISTS"
    assert "rig" in result.message
    log.apply(deregister(1))
    assert registered(log, register(2, name="rig")).alive
    taken = log.apply(register(1, name="rig"))
    assert isinstance(taken, RefusedOperation)


def test_a_host_may_take_another_name_and_frees_the_old_one(log: Log) -> None:
    registered(log, register(1, name="old"))
    registered(log, register(1, name="new"))
    registered(log, register(2, name="old"))
    assert list(log.directory.tables.host_ids) == ["new", "old"]


def test_the_record_of_a_host_that_has_left_stays_while_the_host_owns_channels(log: Log) -> None:
    registered(log, register(1, name="one"))
    channel = channel_at(log, "one", "cam")
    assert isinstance(log.apply(deregister(1)), HostDeregistered)
    assert not log.directory.tables.hosts[channel.host_id].alive
    assert isinstance(log.apply(deregister(1)), HostDeregistered), "leaving twice is leaving once"
    assert isinstance(log.apply(deregister(9)), HostDeregistered), "an unknown host has left already"


def test_only_the_same_process_can_deregister_a_host(log: Log) -> None:
    registered(log, register(1, boot=2))
    result = log.apply(deregister(1, boot=1))
    assert isinstance(result, RefusedOperation)
    assert result.reason == "LEASE_EXPIRED"


def test_the_first_leader_sets_the_cluster_id_and_only_the_first_leader_after_a_restore_changes_it(log: Log) -> None:
    first = log.directory.cluster_id
    log.apply(begin_tenure(8))
    assert log.directory.cluster_id == first
    log.apply(replace(begin_tenure(9), founded_anew=True))
    assert log.directory.cluster_id == "c9"


def test_an_expiry_counts_only_for_its_boot_registration_and_tenure(log: Log) -> None:
    first = registered(log, register(1, boot=1))
    repeated = registered(log, register(1, boot=1))
    late = expire(1, registered_index=first.registered_index)
    stranger = expire(1, boot=9, registered_index=repeated.registered_index)
    deposed = expire(1, registered_index=repeated.registered_index, tenure=2)
    for operation in (late, stranger, deposed, expire(7, registered_index=1)):
        assert log.apply(operation) == HostExpired(expired=False)
    assert log.directory.tables.hosts[id_of(1)].alive
    assert log.apply(expire(1, registered_index=repeated.registered_index)) == HostExpired(expired=True)
    assert not log.directory.tables.hosts[id_of(1)].alive


def lost(log: Log, number: int, *, name: str = "", boot: int = 1) -> HostRecord:
    """A host that has registered and whose lease was ended, as it is remembered then."""
    host = registered(log, register(number, name=name, boot=boot))
    assert log.apply(expire(number, boot=boot, registered_index=host.registered_index)) == HostExpired(expired=True)
    return log.directory.tables.hosts[host.host_id]


def test_the_directory_keeps_the_time_of_the_loss_of_a_lost_host_but_no_record_of_one_that_left(log: Log) -> None:
    log.time_unix_nano = 77
    assert lost(log, 1).lease_ended_unix_nano == 77
    registered(log, register(2))
    log.apply(deregister(2))
    assert set(log.directory.tables.hosts) == {id_of(1)}


def test_a_lost_host_that_registers_or_leaves_is_no_longer_reported_as_lost(log: Log) -> None:
    lost(log, 1)
    assert not registered(log, register(1)).is_lost
    lost(log, 2)
    assert isinstance(log.apply(deregister(2, boot=9)), RefusedOperation), (
        "another process of the host may not deregister it"
    )
    log.apply(deregister(2))
    assert set(log.directory.tables.hosts) == {id_of(1)}
    assert log.directory.tables.lost == set()


def test_a_host_with_the_name_of_a_lost_host_takes_its_place(log: Log) -> None:
    lost(log, 1, name="rig")
    registered(log, register(2, name="rig"))
    assert set(log.directory.tables.hosts) == {id_of(2)}


def test_the_number_of_lost_hosts_is_limited_and_all_replicas_forget_the_same_ones(
    log: Log, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_supernode.core.tables.LOST_HOSTS_MAX", 2)
    for number, ended in ((1, 30), (2, 10)):
        log.time_unix_nano = ended
        lost(log, number)
    log.time_unix_nano = 20
    channel_at_lost = registered(log, register(3, name="three"))
    channel = channel_at(log, "three", "cam")
    log.apply(expire(3, registered_index=channel_at_lost.registered_index))
    assert set(log.directory.tables.hosts) == {id_of(1), id_of(3)}
    log.time_unix_nano = 40
    lost(log, 4)
    assert log.directory.tables.lost == {id_of(1), id_of(4)}
    assert channel.host_id in log.directory.tables.hosts, "the host still owns a channel"
    restored = decode_snapshot(encode_snapshot(log.directory))
    assert restored.tables.lost == log.directory.tables.lost
    assert restored.tables.hosts == log.directory.tables.hosts


def test_hosts_that_own_nothing_and_were_lost_long_ago_are_not_listed(log: Log) -> None:
    log.time_unix_nano = 50
    lost(log, 1)

    def listed(since: int, *, include_dead: bool = True) -> int:
        return len(host_page(log.directory.tables, ("", b""), 0, include_dead=include_dead, lost_since=since).hosts)

    assert [listed(50), listed(51), listed(50, include_dead=False)] == [1, 0, 0]


def test_an_expiry_of_a_replaced_leader_is_ignored(log: Log) -> None:
    host = registered(log, register(1))
    log.apply(begin_tenure(2))
    assert log.apply(expire(1, registered_index=host.registered_index, tenure=1)) == HostExpired(expired=False)


def test_the_first_tenure_founds_the_cluster_and_tenures_never_decrease(log: Log) -> None:
    assert log.apply(begin_tenure(5)) == TenureBegun(tenure=5, cluster_id="c1")
    assert log.apply(begin_tenure(3)) == TenureBegun(tenure=5, cluster_id="c1")


@pytest.mark.parametrize(
    "change",
    [
        {"host_id": b"short"},
        {"name": "-rig"},
        {"gatekeepers": ()},
        {"gatekeepers": (Endpoint(target=""),)},
        {"gatekeepers": (Endpoint(target="a b:1"),)},
        {"gatekeepers": (Endpoint(target="a:1"),) * 17},
        {"version": "v" * 65},
        {"boot_incarnation": 0},
    ],
)
def test_a_registration_out_of_range_is_refused(log: Log, change: dict[str, object]) -> None:
    from dataclasses import replace

    result = log.apply(replace(register(1), **change))  # type: ignore[arg-type]
    assert isinstance(result, RefusedOperation)
    assert result.reason in ("INVALID_ARGUMENT", "INVALID_NAME")


def test_the_number_of_hosts_is_bounded(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transitions, "HOSTS_MAX", 1)
    registered(log, register(1))
    result = log.apply(register(2))
    assert isinstance(result, RefusedOperation)
    assert result.reason == "OVERLOADED"
    registered(log, register(1, boot=2))
