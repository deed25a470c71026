"""Hosts with archives: recorded channels go only to them, and keep their incarnation over clean stops."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.cluster.commands import RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import ARCHIVE_LEVEL, LOADS_LEVEL
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.hosts.commands import RegisterHost
from stampede_rt_supernode.core.records import ChannelRecord, HostLoad
from tests.support.supernode.operations import Log, deregister, id_of, open_channel, register

HOUR = 3600 * 10**9


def with_archive(number: int, *, boot: int = 1, continues: int = 0) -> RegisterHost:
    registration = register(number, boot=boot)
    return replace(registration, has_archive=True, continues_boot_incarnation=continues)


def log_at(level: int) -> Log:
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=level))
    return log


def opened(log: Log, name: str, **policy: int) -> ChannelOpened:
    result = log.apply(open_channel(name, **policy))
    assert isinstance(result, ChannelOpened), result
    return result


def now(log: Log, channel: ChannelRecord) -> ChannelRecord:
    return log.directory.tables.channels[channel.channel_id]


def test_a_recorded_channel_is_placed_on_a_host_with_an_archive_even_if_others_are_less_loaded() -> None:
    log = log_at(ARCHIVE_LEVEL)
    for registration in (register(1), with_archive(2), register(3)):
        log.apply(registration)
    assert [opened(log, f"recorded/{at}", archive_nanos=HOUR).host.name for at in range(3)] == ["host-2"] * 3
    assert opened(log, "plain").host.name != "host-2"
    log.directory = decode_snapshot(encode_snapshot(log.directory))
    assert opened(log, "later", archive_bytes=2**20).host.name == "host-2"


def test_a_new_recorded_channel_is_refused_immediately_where_no_host_can_record_it() -> None:
    log = log_at(ARCHIVE_LEVEL)
    log.apply(register(1))
    refused = log.apply(open_channel("recorded", archive_nanos=HOUR))
    assert isinstance(refused, RefusedOperation)
    assert refused.reason == "INVALID_ARGUMENT"
    assert "no live host has an archive; start one with `stampede host --archive FOLDER` or" in refused.message
    log.apply(with_archive(2))
    named = log.apply(open_channel("recorded", host="host-1", archive_nanos=HOUR))
    assert isinstance(named, RefusedOperation)
    assert "host host-1 has no archive" in named.message


def test_a_recorded_channel_whose_host_is_unreachable_waits_for_a_host_with_an_archive() -> None:
    log = log_at(ARCHIVE_LEVEL)
    log.apply(register(1))
    log.apply(with_archive(2))
    opened(log, "recorded", archive_nanos=HOUR)
    log.apply(deregister(2))
    waits = log.apply(open_channel("recorded"))
    assert isinstance(waits, RefusedOperation)
    assert waits.reason == "NO_HOST"
    log.apply(with_archive(3))
    assert opened(log, "recorded").host.name == "host-3"


def test_only_recorded_channels_keep_their_incarnation_when_the_archive_has_all_their_items() -> None:
    log = log_at(ARCHIVE_LEVEL)
    log.apply(with_archive(1))
    recorded, plain = opened(log, "recorded", archive_nanos=HOUR).channel, opened(log, "plain").channel
    log.apply(deregister(1))
    log.apply(with_archive(1, boot=2, continues=1))
    assert (now(log, recorded).epoch, now(log, recorded).incarnation) == (2, recorded.incarnation)
    assert (now(log, plain).epoch, now(log, plain).incarnation) == (2, 900)
    assert now(log, recorded).first_incarnation == recorded.incarnation
    log.apply(with_archive(1, boot=3, continues=1))  # the note of a process that was not the last one
    assert (now(log, recorded).epoch, now(log, recorded).incarnation) == (3, 900)
    assert (now(log, recorded).first_incarnation, now(log, plain).first_incarnation) == (recorded.incarnation, 0)


def test_below_the_feature_level_of_archives_the_directory_ignores_archives() -> None:
    log = log_at(LOADS_LEVEL - 1)
    log.apply(replace(with_archive(1), archive_place="/data"))
    assert log.directory.tables.hosts[id_of(1)].load is None
    assert log.directory.tables.hosts[id_of(1)].archive_place == ""
    log.apply(RaiseFeatureLevel(feature_level=LOADS_LEVEL))
    log.apply(with_archive(1))
    assert log.directory.tables.hosts[id_of(1)].load == HostLoad(has_archive=True)


def test_the_directory_names_the_place_of_an_archive_also_while_its_host_is_unreachable() -> None:
    log = log_at(ARCHIVE_LEVEL)
    log.apply(replace(with_archive(1), archive_place="/data/my archive"))
    opened(log, "recorded", archive_nanos=HOUR)
    log.apply(deregister(1))
    log.directory = decode_snapshot(encode_snapshot(log.directory))
    assert log.directory.tables.hosts[id_of(1)].archive_place == "/data/my archive"


@pytest.mark.parametrize("place", ["/" * 1025, "/data\x1b"])
def test_a_place_that_is_too_long_or_not_printable_is_refused(place: str) -> None:
    refused = log_at(ARCHIVE_LEVEL).apply(replace(with_archive(1), archive_place=place))
    assert isinstance(refused, RefusedOperation)
    assert (refused.reason, "the place of the archive of host host-1" in refused.message) == ("INVALID_ARGUMENT", True)
