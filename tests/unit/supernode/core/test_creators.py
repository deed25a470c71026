"""How much each caller has made, and when it may make no more."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.cluster.feature_levels import OWNERS_LEVEL
from stampede_rt_supernode.core.commands import Creation, Refused, Result
from stampede_rt_supernode.core.creators import Creators
from stampede_rt_supernode.core.tables import Tables
from tests.support.supernode.operations import (
    Log,
    begin_tenure,
    delete,
    delete_queue,
    open_channel,
    open_queue,
    register,
)


def by(name: str, operation: Creation, created_max: int | None = 2) -> Creation:
    return replace(operation, created_by=name, created_max=created_max)


def log_with_a_host() -> Log:
    log = Log(founded=False)
    log.apply(replace(begin_tenure(1), new_feature_level=OWNERS_LEVEL))
    log.apply(register(1))
    return log


def refusal(result: Result) -> Overloaded:
    assert isinstance(result, Refused)
    error = result.error()
    assert isinstance(error, Overloaded)
    return error


def test_a_caller_makes_as_many_channels_as_its_quota_and_what_it_deletes_makes_room() -> None:
    log = log_with_a_host()
    for number in (10, 11):
        log.apply(by("cam", open_channel(f"c{number}")))
    error = refusal(log.apply(by("cam", open_channel("c12"))))
    assert error.message == (
        "cam has created 2 channels that still exist; its quota channels is 2; delete some, or have an operator raise "
        "it (stampede quota set cam channels=LIMIT)"
    )
    assert error.metadata == {"quota": "channels", "subject": "cam", "used": "2", "limit": "2"}
    log.apply(delete(log.directory.tables.channel_ids["c10"]))
    assert not isinstance(log.apply(by("cam", open_channel("c13"))), Refused)


def test_what_is_there_is_opened_whatever_the_quota_and_others_are_not_counted() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("mine"), 1))
    assert not isinstance(log.apply(by("cam", open_channel("mine"), 1)), Refused)
    assert not isinstance(log.apply(by("other", open_channel("others"), 1)), Refused)
    assert not isinstance(log.apply(by("cam", open_channel("more"), None)), Refused)


def test_queues_have_a_quota_of_their_own() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("c"), 1))
    log.apply(by("cam", open_queue("q"), 1))
    assert refusal(log.apply(by("cam", open_queue("r"), 1))).metadata["quota"] == "queues"
    log.apply(delete_queue(log.directory.tables.queues.ids["q"]))
    assert not isinstance(log.apply(by("cam", open_queue("s"), 1)), Refused)


def test_a_snapshot_counts_as_the_state_that_it_is_of() -> None:
    log = log_with_a_host()
    log.apply(by("cam", open_channel("c")))
    log.apply(by("cam", open_queue("q")))
    tables: Tables = decode_snapshot(encode_snapshot(log.directory)).tables
    assert (tables.channel_creators["cam"], tables.queues.creators["cam"]) == (1, 1)


def test_a_limit_of_nothing_lets_nothing_be_made_and_a_name_that_is_not_known_is_not_counted() -> None:
    creators = Creators()
    with pytest.raises(Overloaded):
        creators.check(Creation(created_by="cam", created_max=0), "channels")
    creators.note("", 1)
    assert creators[""] == 0
