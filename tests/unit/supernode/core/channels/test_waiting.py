"""Recorded channels wait for their host, if only this host has their archive."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.channels.waiting import awaited_host
from stampede_rt_supernode.core.cluster.commands import RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import ARCHIVE_LEVEL
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.hosts.commands import RegisterHost
from tests.support.supernode.operations import Log, deregister, id_of, open_channel, register

HOUR = WAIT = 3600 * 10**9


def archiving(number: int, *, name: str = "", boot: int = 1, wait: int = WAIT) -> RegisterHost:
    return replace(register(number, name=name, boot=boot), has_archive=True, archive_wait_nanos=wait)


@pytest.fixture
def log() -> Log:
    """Two hosts with archives, of which the first has the channels `recorded` and `plain`, and is unreachable."""
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=ARCHIVE_LEVEL))
    log.apply(archiving(1))
    log.apply(open_channel("recorded", archive_nanos=HOUR))
    log.apply(open_channel("plain"))
    log.apply(archiving(2))
    log.apply(deregister(1))
    return log


def opened_at(log: Log, name: str = "recorded", waited_for: int = 0) -> str:
    """The host at which the channel is opened, or the reason of the refusal."""
    result = log.apply(replace(open_channel(name), waited_for_index=waited_for))
    assert isinstance(result, RefusedOperation | ChannelOpened)
    return result.reason if isinstance(result, RefusedOperation) else result.host.name


def test_only_recorded_channels_wait_for_their_host(log: Log) -> None:
    assert opened_at(log) == "NO_HOST"
    refused = log.apply(open_channel("recorded", host="host-2"))
    assert isinstance(refused, RefusedOperation)
    assert "waits for host host-1" in refused.message
    assert "start host host-1 again; 3600 s after the first call" in refused.message
    assert opened_at(log, "plain") == "host-2"
    log.apply(archiving(1, boot=2))
    assert opened_at(log) == "host-1"


def test_a_channel_goes_to_another_host_after_the_wait_for_this_registration(log: Log) -> None:
    host = awaited_host(log.directory.tables, "recorded")
    assert host is not None
    waited_for = host.registered_index
    log.apply(archiving(1, boot=2))
    log.apply(deregister(1, boot=2))
    log.directory = decode_snapshot(encode_snapshot(log.directory))
    assert opened_at(log, waited_for=waited_for) == "NO_HOST"
    assert opened_at(log, waited_for=log.directory.tables.hosts[id_of(1)].registered_index) == "host-2"


def test_a_channel_does_not_wait_if_another_host_has_taken_the_name_of_its_host(log: Log) -> None:
    log.apply(archiving(3, name="host-1"))
    assert opened_at(log) == "host-1"


def test_a_channel_does_not_wait_if_other_hosts_have_its_archive(log: Log) -> None:
    log.apply(archiving(1, boot=2, wait=0))
    log.apply(deregister(1, boot=2))
    assert opened_at(log) == "host-2"


def test_below_the_feature_level_of_archives_no_replica_keeps_the_wait() -> None:
    log = Log()
    log.apply(archiving(1))
    assert log.directory.tables.hosts[id_of(1)].archive_wait_nanos == 0
