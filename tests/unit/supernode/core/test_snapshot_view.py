"""A snapshot shows one moment, although the directory changes. The next snapshot writes only the changes since then."""

from __future__ import annotations

import gc
import weakref

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import SnapshotWriter, encode_snapshot
from stampede_rt_supernode.core.change_ring import CHANGES_MAX
from stampede_rt_supernode.core.snapshot_view import snapshot_view
from stampede_rt_supernode.replica import DirectoryReplica
from tests.support.supernode.operations import (
    Log,
    delete,
    deregister,
    deregister_peer,
    open_channel,
    open_queue,
    register,
    register_peer,
)


@pytest.fixture
def log() -> Log:
    log = Log()
    for number in (1, 2):
        log.apply(register(number))
    for name in ("b", "a", "c"):
        log.apply(open_channel(name, host="host-1", max_items=5))
        log.apply(open_queue(name, host="host-1"))
    for number in (7, 8):
        log.apply(register_peer(number, f"peer-{number}"))
    return log


def apply_later_changes(log: Log) -> None:
    for name in ("0", "aa", "z"):
        log.apply(open_channel(name, host="host-2", max_items=5))
        log.apply(open_queue(name, host="host-2", max_items=5))
    log.apply(deregister_peer(7))
    log.apply(register_peer(9, "peer-7"))
    log.apply(deregister(2))
    log.apply(register(3))


@pytest.mark.parametrize("snapshots_before", [0, 1])
def test_later_changes_are_not_in_a_snapshot(log: Log, snapshots_before: int) -> None:
    writer = SnapshotWriter()
    for _ in range(snapshots_before):
        writer.begin(log.directory)()
    before = encode_snapshot(log.directory)
    encode = writer.begin(log.directory)
    apply_later_changes(log)
    assert encode() == before != encode_snapshot(log.directory)
    assert writer.begin(log.directory)() == encode_snapshot(log.directory)


def test_a_later_snapshot_takes_only_the_channels_that_changed(log: Log) -> None:
    position = snapshot_view(log.directory).position
    apply_later_changes(log)
    view = snapshot_view(log.directory, position)
    assert view.changes is not None
    assert view.channels == ()
    assert len(view.changes) < len(log.directory.tables.changes._changes)


def test_the_snapshot_has_the_new_channel_after_a_deletion_and_another_open(log: Log) -> None:
    writer = SnapshotWriter()
    writer.begin(log.directory)()
    log.apply(delete(log.directory.tables.channel_ids["a"]))
    log.apply(open_channel("a", host="host-2"))
    log.apply(delete(log.directory.tables.channel_ids["b"]))
    assert writer.begin(log.directory)() == encode_snapshot(log.directory)


def test_all_channels_are_written_when_there_were_too_many_changes(log: Log) -> None:
    writer = SnapshotWriter()
    writer.begin(log.directory)()
    position = snapshot_view(log.directory).position
    for change in [*log.directory.tables.changes._changes][:1] * (CHANGES_MAX + 1):
        log.directory.tables.changes.append(change)
    apply_later_changes(log)
    assert len(snapshot_view(log.directory, position).channels) == len(log.directory.tables.channels)
    assert writer.begin(log.directory)() == encode_snapshot(log.directory)


def test_an_unused_view_does_not_change_later_snapshots(log: Log) -> None:
    writer = SnapshotWriter()
    writer.begin(log.directory)()
    log.apply(open_channel("d", host="host-1"))
    writer.begin(log.directory)
    log.apply(open_channel("e", host="host-1"))
    assert writer.begin(log.directory)() == encode_snapshot(log.directory)


def test_a_state_that_was_replaced_is_freed_without_the_garbage_collector(log: Log) -> None:
    replica = DirectoryReplica()
    snapshot = encode_snapshot(log.directory)
    replica.prepare_restore(snapshot)()
    outdated = replica.read(lambda directory: weakref.ref(directory.tables))
    gc.disable()
    try:
        replica.prepare_restore(snapshot)()
        assert outdated() is None
    finally:
        gc.enable()
