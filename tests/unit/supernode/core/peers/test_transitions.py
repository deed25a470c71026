"""Peers in the directory: at most one live peer for each name, and one mailbox for each live peer with a name."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.commands import Operation, RefusedOperation
from stampede_rt_supernode.core.peers import table, transitions
from stampede_rt_supernode.core.peers.commands import PeerRegistered, PeersExpired
from stampede_rt_supernode.core.peers.queries import BEGINNING, peer_page
from stampede_rt_supernode.core.records import PeerRecord, QueueRecord, QueueSpec
from tests.support.supernode.operations import (
    Log,
    delete_queue,
    deregister,
    deregister_peer,
    expire_peers,
    id_of,
    open_queue,
    register,
    register_peer,
    update_queue,
)


@pytest.fixture
def log() -> Log:
    log = Log()
    log.apply(register(1, name="one"))
    log.apply(register(2, name="two"))
    return log


def enter(log: Log, number: int, name: str = "", **how: Any) -> PeerRegistered:
    entered = log.apply(register_peer(number, name, **how))
    assert isinstance(entered, PeerRegistered), entered
    return entered


def mailbox(log: Log, number: int, name: str, **how: Any) -> QueueRecord:
    made = enter(log, number, name, **how).mailbox
    assert made is not None
    return made


def refusal(log: Log, operation: Operation) -> RefusedOperation:
    result = log.apply(operation)
    assert isinstance(result, RefusedOperation)
    return result


def peer(log: Log, number: int) -> PeerRecord:
    return log.directory.tables.peers.by_id[id_of(number)]


def end_lease(log: Log, number: int) -> None:
    held = peer(log, number)
    ended = log.apply(expire_peers((number, held.registered_index), boot=held.boot_incarnation))
    assert ended == PeersExpired(expired=1)


def queues(log: Log) -> list[QueueRecord]:
    return list(log.directory.tables.queues.by_id.values())


def test_a_peer_with_a_name_gets_a_mailbox_and_a_peer_without_a_name_gets_none(log: Log) -> None:
    entered = enter(log, 7, "planner")
    assert entered.mailbox is not None
    assert entered.mailbox.spec == QueueSpec(max_items=1024)
    assert (entered.mailbox.mailbox_peer_id, entered.mailbox_kept) == (id_of(7), False)
    assert entered.peer.mailbox_queue_id == entered.mailbox.queue_id
    bare = enter(log, 8)
    assert (bare.mailbox, bare.mailbox_host, bare.peer.mailbox_queue_id) == (None, None, None)
    assert queues(log) == [entered.mailbox]


def test_a_peer_chooses_the_settings_and_the_host_of_its_mailbox(log: Log) -> None:
    made = mailbox(log, 7, "planner", mailbox=QueueSpec(max_bytes=9), mailbox_host_name="two")
    assert (made.spec, made.host_id) == (QueueSpec(max_bytes=9), id_of(2))
    assert refusal(log, register_peer(8, "x", mailbox_host_name="none")).reason == "HOST_NOT_FOUND"
    assert refusal(log, register_peer(8, "x", mailbox=QueueSpec(copies=0))).reason == "INVALID_ARGUMENT"
    dead_letter = QueueSpec(dead_letter_queue_id=id_of(99))
    assert refusal(log, register_peer(8, "x", mailbox=dead_letter)).reason == "QUEUE_NOT_FOUND"
    assert refusal(log, register_peer(8, mailbox=QueueSpec())).reason == "INVALID_ARGUMENT"


@pytest.mark.parametrize(
    "how",
    [
        {"boot": 0},
        {"zone": "z" * 65},
        {"version": "a b"},
        {"host_id": b"short"},
        {"attributes": tuple((str(number), "") for number in range(33))},
        {"attributes": (("a", "x" * 4096),)},
        {"attributes": (("", "x"),)},
    ],
)
def test_the_directory_refuses_a_peer_with_invalid_fields(log: Log, how: dict[str, Any]) -> None:
    assert refusal(log, register_peer(7, "planner", **how)).reason == "INVALID_ARGUMENT"


def test_the_directory_refuses_a_peer_with_an_invalid_name_or_an_unknown_host(log: Log) -> None:
    assert refusal(log, register_peer(7, "the planner")).reason == "INVALID_NAME"
    assert refusal(log, register_peer(7, "planner", host_id=id_of(99))).reason == "HOST_NOT_FOUND"
    assert enter(log, 7, "planner", host_id=id_of(1)).peer.host_id == id_of(1)


@pytest.mark.parametrize(("first", "second"), [(0, 0), (1, 0), (0, 1), (1, 2)])
def test_a_peer_without_the_proof_cannot_take_the_name_of_a_live_peer(log: Log, first: int, second: int) -> None:
    held = mailbox(log, 7, "planner", proof=first)
    refused = refusal(log, register_peer(8, "planner", proof=second))
    assert (refused.reason, refused.metadata["peer"]) == ("PEER_EXISTS", "planner")
    assert (queues(log), list(log.directory.tables.peers.by_id)) == ([held], [id_of(7)])


def test_a_peer_with_the_proof_takes_over_the_name_and_the_mailbox(log: Log) -> None:
    held = mailbox(log, 7, "planner", proof=1)
    entered = enter(log, 8, "planner", boot=2, proof=1)
    assert entered.mailbox is not None
    assert (entered.mailbox_kept, entered.mailbox.queue_id, entered.mailbox.epoch) == (True, held.queue_id, held.epoch)
    assert entered.mailbox.mailbox_peer_id == id_of(8)
    assert list(log.directory.tables.peers.by_id) == [id_of(8)]
    assert queues(log) == [entered.mailbox]


def test_a_restarted_process_needs_the_proof_to_register_the_same_peer_id(log: Log) -> None:
    enter(log, 7, "planner")
    assert refusal(log, register_peer(7, "planner", boot=2)).reason == "PEER_EXISTS"
    assert refusal(log, register_peer(7, boot=2)).reason == "PEER_EXISTS", (
        "the process may not give the name up, either"
    )
    assert enter(log, 7, "planner").mailbox_kept, "the same process may register again"
    enter(log, 8, proof=1)
    assert refusal(log, register_peer(8, boot=2)).reason == "PEER_EXISTS"
    enter(log, 9)
    enter(log, 9, boot=2)  # this peer has no name, so the directory asks for no proof


def test_a_peer_that_restarts_with_its_proof_keeps_its_mailbox_and_may_change_its_settings(log: Log) -> None:
    held = mailbox(log, 7, "planner", proof=1)
    entered = enter(log, 7, "planner", boot=2, proof=1, mailbox=QueueSpec(max_items=5))
    assert entered.mailbox is not None
    assert (entered.mailbox.spec, entered.mailbox.spec_version) == (QueueSpec(max_items=5), 2)
    assert (entered.mailbox.incarnation, entered.mailbox_kept) == (held.incarnation, True)


def test_a_peer_that_changes_its_name_gets_another_mailbox(log: Log) -> None:
    held = mailbox(log, 7, "planner")
    entered = enter(log, 7, "driver")
    assert entered.mailbox is not None
    assert (entered.mailbox.queue_id != held.queue_id, entered.mailbox_kept) == (True, False)
    assert queues(log) == [entered.mailbox]
    enter(log, 8, "planner")


def test_a_peer_that_takes_over_another_name_frees_its_former_name(log: Log) -> None:
    enter(log, 7, "planner", proof=1)
    taken = mailbox(log, 8, "driver", proof=1)
    entered = enter(log, 7, "driver", proof=1)
    assert entered.mailbox is not None
    assert (entered.mailbox.queue_id, len(queues(log))) == (taken.queue_id, 1)
    assert list(log.directory.tables.peers.ids) == ["driver"]


def test_a_peer_that_leaves_frees_its_name_and_its_mailbox_is_deleted(log: Log) -> None:
    enter(log, 7, "planner")
    log.apply(deregister_peer(7))
    assert (queues(log), len(log.directory.tables.peers)) == ([], 0)
    enter(log, 8, "planner")


def test_the_mailbox_of_a_peer_is_deleted_when_its_lease_ends_and_a_record_is_kept(log: Log) -> None:
    enter(log, 7, "planner")
    end_lease(log, 7)
    assert queues(log) == []
    assert (peer(log, 7).alive, peer(log, 7).mailbox_queue_id) == (False, None)
    assert not enter(log, 8, "planner").mailbox_kept
    repeated = enter(log, 7, "driver", boot=2)
    assert repeated.peer.alive, "after the end of the lease no proof is needed"


def test_a_stale_expiry_of_a_lease_changes_nothing(log: Log) -> None:
    index = enter(log, 7, "planner").peer.registered_index
    nothing = PeersExpired(expired=0)
    assert log.apply(expire_peers((7, index), tenure=2)) == nothing
    assert log.apply(expire_peers((7, index), boot=2)) == nothing
    assert log.apply(expire_peers((7, index - 1), (99, index))) == nothing
    enter(log, 7, "planner")
    assert log.apply(expire_peers((7, index))) == nothing
    assert peer(log, 7).alive


def test_one_command_ends_many_leases(log: Log) -> None:
    indexes = {number: enter(log, number, f"p{number}").peer.registered_index for number in (7, 8, 9)}
    ended = log.apply(expire_peers((9, indexes[9]), (7, indexes[7]), (9, indexes[9]), (8, indexes[8] + 1)))
    assert ended == PeersExpired(expired=2)
    assert [one.peer_id for one in log.directory.tables.peers.live()] == [id_of(8)]
    assert len(queues(log)) == 1


def test_the_directory_keeps_only_the_peers_that_died_last(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table, "DEAD_PEERS_MAX", 2)
    for number in (9, 8, 7):
        enter(log, number, "planner")
        end_lease(log, number)
    assert sorted(log.directory.tables.peers.by_id) == [id_of(7), id_of(8)]
    restored = decode_snapshot(encode_snapshot(log.directory))
    assert list(restored.tables.peers._dead) == [id_of(8), id_of(7)], (
        "the dead peers are in the order in which their leases ended"
    )


def test_a_caller_can_change_a_mailbox_but_cannot_delete_it(log: Log) -> None:
    held = mailbox(log, 7, "planner")
    log.apply(update_queue(held.queue_id, copies=2))
    assert queues(log)[0].spec.copies == 2
    refused = refusal(log, delete_queue(held.queue_id))
    assert (refused.reason, "mailbox" in refused.message) == ("INVALID_ARGUMENT", True)
    log.apply(deregister_peer(7))
    assert queues(log) == []


def test_the_mailboxes_of_a_lost_host_move_to_another_host_immediately(log: Log) -> None:
    held = mailbox(log, 7, "planner", mailbox_host_name="one", incarnation=5)
    log.apply(open_queue("jobs", host="one"))
    log.apply(deregister(1))
    moved = log.directory.tables.queues.by_id[held.queue_id]
    assert (moved.host_id, moved.epoch, moved.incarnation) == (id_of(2), 2, 6)
    assert peer(log, 7).mailbox_queue_id == held.queue_id


def test_mailboxes_without_a_host_are_placed_on_the_first_host_that_registers(log: Log) -> None:
    held = mailbox(log, 7, "planner")
    for number in (1, 2):
        log.apply(deregister(number))
    assert not log.directory.tables.hosts[queues(log)[0].host_id].alive
    log.apply(register(3, name="three"))
    moved = log.directory.tables.queues.by_id[held.queue_id]
    assert moved.host_id == id_of(3)
    assert moved.epoch > held.epoch
    assert list(log.directory.tables.hosts) == [id_of(3)], "nothing belongs to the lost hosts any more"


def test_a_peer_whose_mailbox_has_no_host_gets_the_error_that_no_host_has_room(log: Log) -> None:
    enter(log, 7, "planner")
    for number in (1, 2):
        log.apply(deregister(number))
    assert refusal(log, register_peer(7, "planner")).reason == "NO_HOST"


def test_a_mailbox_gets_another_incarnation_when_its_host_restarts(log: Log) -> None:
    held = mailbox(log, 7, "planner", mailbox_host_name="one")
    log.apply(register(1, name="one", boot=2))
    entered = enter(log, 7, "planner")
    assert entered.mailbox is not None
    assert (entered.mailbox.host_id, entered.mailbox.epoch) == (id_of(1), 2)
    assert entered.mailbox.incarnation != held.incarnation


def test_the_limit_of_peers_refuses_new_peers_but_no_registered_peer(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transitions, "PEERS_MAX", 1)
    enter(log, 7)
    assert refusal(log, register_peer(8)).reason == "OVERLOADED"
    enter(log, 7, "planner")
    end_lease(log, 7)
    enter(log, 8)


def test_the_directory_keeps_the_changes_of_peers_apart_from_the_changes_of_channels(log: Log) -> None:
    before = log.directory.tables.changes.end_position
    for number in range(100, 110):
        enter(log, number)
    assert log.directory.tables.changes.end_position == before
    assert log.directory.tables.peers.changes.end_position == 10


def test_a_page_names_the_start_of_the_next_page(log: Log) -> None:
    for number, name in ((5, "b"), (6, "a"), (4, "")):
        enter(log, number, name)
    tables = log.directory.tables
    first = peer_page(tables, "", BEGINNING, 2, include_dead=False)
    assert ([one.name for one in first.peers], first.last) == (["a", "b"], (False, "b", id_of(5)))
    assert first.last is not None
    rest = peer_page(tables, "", first.last, 2, include_dead=False)
    assert ([one.peer_id for one in rest.peers], rest.last) == ([id_of(4)], None)
