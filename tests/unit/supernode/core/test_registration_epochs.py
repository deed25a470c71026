"""A request of an older process of a peer or host is not performed after its newer process has registered.

The scenario: a peer's process asks to register, and the network holds the request. The process is killed and started
again, and the new process registers. Then the held request arrives. In an earlier version, the held request took the
name from the live process.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.commands import Operation, RefusedOperation, Result
from stampede_rt_supernode.core.hosts.commands import HostRegistered
from stampede_rt_supernode.core.peers.commands import PeerRegistered
from stampede_rt_supernode.core.records import HostRecord, PeerRecord
from tests.support.supernode.operations import (
    Log,
    deregister,
    deregister_peer,
    expire,
    expire_peers,
    id_of,
    open_channel,
    register,
    register_peer,
)

Make = Callable[..., Operation]
KINDS = [
    pytest.param(partial(register, 1, name="it"), id="host"),
    pytest.param(partial(register_peer, 1, "it", proof=5), id="peer"),
]


@pytest.fixture
def log() -> Log:
    log = Log()
    log.apply(register(9, name="nine"))
    return log


def record_of(log: Log) -> HostRecord | PeerRecord:
    tables = log.directory.tables
    return tables.hosts.get(id_of(1)) or tables.peers.by_id[id_of(1)]


def epoch_in(result: Result) -> int:
    assert isinstance(result, HostRegistered | PeerRegistered)
    return (result.host if isinstance(result, HostRegistered) else result.peer).registration_epoch


def assert_stale(result: Result, *, reached: int, alive: bool = True) -> None:
    assert isinstance(result, RefusedOperation)
    assert result.reason == "STALE_REGISTRATION"
    reported = result.metadata["registration_epoch"], result.metadata["alive"]
    assert reported == (str(reached), "true" if alive else "false")
    assert f"registers with epoch {reached + 1}" in result.message


@pytest.mark.parametrize("made", KINDS)
def test_a_late_registration_of_an_older_process_is_refused(log: Log, made: Make) -> None:
    assert epoch_in(log.apply(made(boot=1, epoch=0))) == 0
    assert_stale(log.apply(made(boot=2, epoch=0)), reached=0)
    late = made(boot=2, epoch=1)  # the next request of the second process, which the network holds
    assert epoch_in(log.apply(made(boot=3, epoch=1))) == 1
    before = record_of(log)
    assert_stale(log.apply(late), reached=1)
    assert_stale(log.apply(late), reached=1)
    assert record_of(log) == before


@pytest.mark.parametrize("made", KINDS)
def test_the_newer_process_takes_the_next_epoch_if_the_request_of_the_older_one_came_first(
    log: Log, made: Make
) -> None:
    log.apply(made(boot=2, epoch=1))
    assert_stale(log.apply(made(boot=3, epoch=1)), reached=1)
    assert epoch_in(log.apply(made(boot=3, epoch=2))) == 2


@pytest.mark.parametrize("made", KINDS)
def test_a_process_registers_again_with_its_epoch_and_late_requests_do_not_lower_the_epoch(
    log: Log, made: Make
) -> None:
    log.apply(made(boot=3, epoch=4))
    assert epoch_in(log.apply(made(boot=3, epoch=4))) == 4
    assert epoch_in(log.apply(made(boot=3, epoch=2))) == 4, "the process sent it before it learned the higher epoch"
    assert_stale(log.apply(made(boot=2, epoch=4)), reached=4)


@pytest.mark.parametrize("made", KINDS)
def test_a_repeated_request_is_answered_as_before_and_changes_nothing(log: Log, made: Make) -> None:
    first = made(boot=2, epoch=0)
    answer = log.apply(first, op_id=id_of(77))
    log.apply(made(boot=3, epoch=1))
    before = record_of(log)
    assert log.apply(first, op_id=id_of(77)) == answer
    assert record_of(log) == before


@pytest.mark.parametrize("made", KINDS)
def test_a_late_registration_is_also_refused_after_the_newer_process_has_died(log: Log, made: Make) -> None:
    log.apply(made(boot=3, epoch=1))
    at = log.directory.applied_index
    ended = expire(1, boot=3, registered_index=at) if isinstance(record_of(log), HostRecord) else None
    log.apply(ended or expire_peers((1, at), boot=3))
    assert not record_of(log).alive
    assert_stale(log.apply(made(boot=2, epoch=1)), reached=1, alive=False)


def test_a_late_registration_does_not_revive_a_host_that_has_left_but_still_owns_channels(log: Log) -> None:
    log.apply(register(1, name="it", boot=3, epoch=1))
    log.apply(open_channel("x", host="it"))
    log.apply(deregister(1, boot=3))
    assert_stale(log.apply(register(1, name="it", boot=2, epoch=1)), reached=1, alive=False)


def test_a_late_registration_of_a_peer_that_has_left_delays_its_successor_by_one_request(log: Log) -> None:
    log.apply(register_peer(1, "it", boot=3, epoch=1, proof=5))
    log.apply(deregister_peer(1, boot=3))
    assert epoch_in(log.apply(register_peer(1, "it", boot=2, epoch=1, proof=5))) == 1
    assert_stale(log.apply(register_peer(1, "it", boot=4, epoch=0, proof=5)), reached=1)
    assert epoch_in(log.apply(register_peer(1, "it", boot=4, epoch=2, proof=5))) == 2


def test_a_late_registration_is_refused_by_its_name_if_the_newer_process_has_another_id(log: Log) -> None:
    log.apply(register_peer(1, "it", boot=1, epoch=0, proof=5))
    log.apply(register_peer(2, "it", boot=2, epoch=1, proof=5))
    late = log.apply(register_peer(1, "it", boot=3, epoch=1, proof=5))
    assert_stale(late, reached=1)
    assert log.directory.tables.peers.ids["it"] == id_of(2)


def test_the_error_for_a_used_name_shows_no_epoch_to_another_caller(log: Log) -> None:
    log.apply(register_peer(1, "it", boot=1, proof=5))
    refused = log.apply(register_peer(2, "it", boot=2, epoch=7, proof=6))
    assert isinstance(refused, RefusedOperation)
    assert (refused.reason, "registration_epoch" in refused.metadata) == ("PEER_EXISTS", False)


@pytest.mark.parametrize("made", KINDS)
def test_a_snapshot_keeps_the_registration_epoch(log: Log, made: Make) -> None:
    log.apply(made(boot=3, epoch=4))
    log.directory = decode_snapshot(encode_snapshot(log.directory))
    assert_stale(log.apply(made(boot=2, epoch=4)), reached=4)


@pytest.mark.parametrize("made", KINDS)
@pytest.mark.parametrize("epoch", [-1, 2**63])
def test_a_registration_epoch_beyond_the_limit_is_refused(log: Log, made: Make, epoch: int) -> None:
    refused = log.apply(made(boot=3, epoch=epoch))
    assert isinstance(refused, RefusedOperation)
    assert (refused.reason, refused.metadata["field"]) == ("INVALID_ARGUMENT", "registration_epoch")
