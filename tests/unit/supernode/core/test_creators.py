"""The number of things that each caller has made, and its limit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.cluster.feature_levels import GROUPS_AND_PEERS_LEVEL
from stampede_rt_supernode.core.commands import Creation, RefusedOperation, Result
from stampede_rt_supernode.core.creators import Creators
from stampede_rt_supernode.core.groups import transitions as group_transitions
from stampede_rt_supernode.core.tables import Tables
from tests.support.supernode.operations import (
    Log,
    begin_tenure,
    delete,
    delete_group,
    delete_queue,
    deregister_peer,
    expire_peers,
    id_of,
    open_channel,
    open_group,
    open_queue,
    register,
    register_peer,
    update_group,
)


def by(name: str, operation: Creation, created_max: int | None = 2) -> Creation:
    return replace(operation, created_by=name, created_max=created_max)


def log_with_a_host(feature_level: int = GROUPS_AND_PEERS_LEVEL) -> Log:
    log = Log(founded=False)
    log.apply(replace(begin_tenure(1), new_feature_level=feature_level))
    log.apply(register(1))
    return log


def refusal(result: Result) -> Overloaded:
    assert isinstance(result, RefusedOperation)
    error = result.error()
    assert isinstance(error, Overloaded)
    return error


def test_a_caller_makes_as_many_channels_as_its_quota_and_deletions_make_room() -> None:
    log = log_with_a_host()
    for number in (10, 11):
        log.apply(by("cam", open_channel(f"c{number}")))
    error = refusal(log.apply(by("cam", open_channel("c12"))))
    assert error.message == (
        "cam has created 2 channels that still exist; its quota of channels is 2; delete some, or have an operator "
        "raise the quota (stampede quota set cam channels=LIMIT)"
    )
    assert error.metadata == {"quota": "channels", "subject": "cam", "used": "2", "limit": "2"}
    log.apply(delete(log.directory.tables.channel_ids["c10"]))
    assert not isinstance(log.apply(by("cam", open_channel("c13"))), RefusedOperation)


def test_an_existing_channel_opens_under_any_quota_and_channels_of_others_do_not_count() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("mine"), 1))
    assert not isinstance(log.apply(by("cam", open_channel("mine"), 1)), RefusedOperation)
    assert not isinstance(log.apply(by("other", open_channel("others"), 1)), RefusedOperation)
    assert not isinstance(log.apply(by("cam", open_channel("more"), None)), RefusedOperation)


def test_queues_have_a_quota_of_their_own() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("c"), 1))
    log.apply(by("cam", open_queue("q"), 1))
    assert refusal(log.apply(by("cam", open_queue("r"), 1))).metadata["quota"] == "queues"
    log.apply(delete_queue(log.directory.tables.queues.ids["q"]))
    assert not isinstance(log.apply(by("cam", open_queue("s"), 1)), RefusedOperation)


def test_groups_have_a_quota_of_their_own_and_a_group_deleted_with_its_channel_makes_room() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("c"), 1))
    channel = log.directory.tables.channel_ids["c"]
    log.apply(by("cam", open_group("g", (channel,))))
    log.apply(by("cam", open_group("h", (channel,))))
    error = refusal(log.apply(by("cam", open_group("i", (channel,)))))
    assert error.metadata == {"quota": "groups", "subject": "cam", "used": "2", "limit": "2"}
    assert not error.retryable
    assert not isinstance(log.apply(by("cam", open_group("g", (channel,)))), RefusedOperation), "the group exists"
    log.apply(delete_group(log.directory.tables.groups.ids["g"]))
    assert not isinstance(log.apply(by("cam", open_group("i", (channel,)))), RefusedOperation)
    log.apply(delete(channel))
    assert log.directory.tables.groups.creators["cam"] == 0


def test_live_peers_have_a_quota_and_a_peer_that_registers_again_counts_once() -> None:
    log = log_with_a_host()
    log.apply(by("cam", register_peer(1, "one", proof=1)))
    log.apply(by("cam", register_peer(2)))
    error = refusal(log.apply(by("cam", register_peer(3))))
    assert error.message == (
        "cam has registered 2 peers that still exist; its quota of peers is 2; let some leave, or have an operator "
        "raise the quota (stampede quota set cam peers=LIMIT)"
    )
    assert error.retryable, "the lease of a peer may end"
    assert not isinstance(log.apply(by("cam", register_peer(4, "one", proof=1, boot=2))), RefusedOperation)
    assert not isinstance(log.apply(by("other", register_peer(5), 1)), RefusedOperation)
    log.apply(deregister_peer(2))
    assert not isinstance(log.apply(by("cam", register_peer(3))), RefusedOperation)
    log.apply(expire_peers((3, log.directory.tables.peers.by_id[id_of(3)].registered_index)))
    assert log.directory.tables.peers.creators["cam"] == 1


def test_one_caller_cannot_use_up_the_groups_of_a_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(group_transitions, "GROUPS_PER_CHANNEL_AND_CALLER_MAX", 2)
    log = log_with_a_host()
    for name in ("shared", "own"):
        log.apply(by("cam", open_channel(name), None))
    shared, own = (log.directory.tables.channel_ids[name] for name in ("shared", "own"))
    for name in ("a", "b"):
        log.apply(by("cam", open_group(name, (shared,)), None))
    assert (
        "cam has created 2 groups with that channel"
        in refusal(log.apply(by("cam", open_group("c", (shared,)), None))).message
    )
    log.apply(by("cam", open_group("c", (own,)), None))
    group_id = log.directory.tables.groups.ids["c"]
    assert "the limit for one caller" in refusal(log.apply(update_group(group_id, add=(shared,)))).message
    for name, caller in (("d", "other"), ("e", "@clients"), ("f", "@clients"), ("g", "@clients")):
        assert not isinstance(log.apply(by(caller, open_group(name, (shared,)), None)), RefusedOperation)
    log.apply(delete_group(log.directory.tables.groups.ids["a"]))
    assert not isinstance(log.apply(update_group(group_id, add=(shared,))), RefusedOperation)


def test_groups_and_peers_have_no_quota_below_the_feature_level_of_these_quotas(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(group_transitions, "GROUPS_PER_CHANNEL_AND_CALLER_MAX", 0)
    log = log_with_a_host(GROUPS_AND_PEERS_LEVEL - 1)
    log.apply(by("cam", open_channel("c")))
    channel = log.directory.tables.channel_ids["c"]
    assert not isinstance(log.apply(by("cam", open_group("g", (channel,)), 0)), RefusedOperation)
    assert not isinstance(log.apply(by("cam", register_peer(1), 0)), RefusedOperation)
    assert log.directory.tables.peers.creators["cam"] == 0, "a replica of an earlier release does not count the peer"


def test_a_state_read_from_a_snapshot_has_the_same_counts() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("c")))
    log.apply(by("cam", open_queue("q")))
    log.apply(by("cam", open_group("g", tuple(log.directory.tables.channels))))
    log.apply(by("cam", register_peer(1, "p")))
    tables: Tables = decode_snapshot(encode_snapshot(log.directory)).tables
    assert (tables.channel_creators["cam"], tables.queues.creators["cam"]) == (1, 1)
    assert (tables.groups.creators["cam"], tables.peers.creators["cam"]) == (1, 1)
    [channel] = tables.channels
    assert tables.groups.count_created_with(channel, "cam") == 1


def test_a_quota_of_zero_refuses_every_new_thing_and_things_without_a_maker_are_not_counted() -> None:
    creators = Creators()
    with pytest.raises(Overloaded):
        creators.check(Creation(created_by="cam", created_max=0), "channels")
    creators.note("", 1)
    assert creators[""] == 0
