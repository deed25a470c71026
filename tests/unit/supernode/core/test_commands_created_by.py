"""Channels, queues and groups record their creators."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.cluster.feature_levels import OWNERS_LEVEL
from stampede_rt_supernode.core.commands import Creation
from stampede_rt_supernode.core.tables import Tables
from tests.support.supernode.operations import (
    Log,
    begin_tenure,
    deregister,
    open_channel,
    open_group,
    open_queue,
    register,
)

C = TypeVar("C", bound=Creation)


def by(operation: C, name: str) -> C:
    return replace(operation, created_by=name)


def filled(*, feature_level: int) -> Log:
    log = Log(founded=False)
    log.apply(replace(begin_tenure(1), new_feature_level=feature_level))
    log.apply(register(1))
    log.apply(by(open_channel("cam"), "alice"))
    log.apply(by(open_queue("jobs"), "bob"))
    [channel] = log.directory.tables.channels.values()
    log.apply(by(open_group("all", (channel.channel_id,)), "@cluster"))
    return log


def creators(tables: Tables) -> list[str]:
    records = (tables.channel_named("cam"), tables.queues.named("jobs"), tables.groups.named("all"))
    return [one.created_by for one in records if one is not None]


def test_the_maker_of_a_thing_does_not_change() -> None:
    log = filled(feature_level=OWNERS_LEVEL)
    assert creators(log.directory.tables) == ["alice", "bob", "@cluster"]
    log.apply(deregister(1))
    log.apply(register(2))
    for operation in (open_channel("cam"), open_queue("jobs"), open_group("all", None, create=False)):
        log.apply(by(operation, "mallory"))
    assert creators(log.directory.tables) == ["alice", "bob", "@cluster"]
    read = decode_snapshot(encode_snapshot(log.directory))
    assert creators(read.tables) == ["alice", "bob", "@cluster"]


def test_below_the_feature_level_of_owners_no_maker_is_kept() -> None:
    assert creators(filled(feature_level=OWNERS_LEVEL - 1).directory.tables) == ["", "", ""]
