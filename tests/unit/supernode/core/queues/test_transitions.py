"""Queues in the directory: names, set-ups, places and dead-letter queues."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt.v1 import directory_command_pb2
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.commands import Operation, RefusedOperation
from stampede_rt_supernode.core.queues import transitions
from stampede_rt_supernode.core.queues.commands import QueueOpened, QueueUpdated
from stampede_rt_supernode.core.queues.queries import BEGINNING, queue_page
from stampede_rt_supernode.core.records import QueueRecord, QueueSpec
from tests.support.supernode.operations import (
    Log,
    delete_queue,
    deregister,
    expire,
    id_of,
    open_channel,
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


def queue(log: Log, name: str, **how: Any) -> QueueRecord:
    opened = log.apply(open_queue(name, **how))
    assert isinstance(opened, QueueOpened), opened
    return opened.queue


def refusal(log: Log, operation: Operation) -> RefusedOperation:
    result = log.apply(operation)
    assert isinstance(result, RefusedOperation)
    return result


def host_of(log: Log, name: str) -> str:
    held = log.directory.tables.queues.named(name)
    assert held is not None
    return log.directory.tables.hosts[held.host_id].name


def test_the_first_of_two_creators_wins_and_the_other_gets_the_same_queue(log: Log) -> None:
    first, second = log.apply(open_queue("jobs", max_items=5)), log.apply(open_queue("jobs"))
    assert isinstance(first, QueueOpened)
    assert first.created
    assert second == QueueOpened(queue=first.queue, host=first.host, created=False)


def test_queues_go_to_the_host_with_the_fewest_channels_and_queues(log: Log) -> None:
    log.apply(open_channel("a", host="one"))
    assert [host_of(log, queue(log, name).name) for name in ("q", "r", "s")] == ["two", "one", "two"]
    queue(log, "here", host="two")
    assert host_of(log, "here") == "two"
    assert refusal(log, open_queue("x", host="none")).reason == "HOST_NOT_FOUND"


def test_without_a_live_host_no_queue_can_be_opened() -> None:
    assert refusal(Log(), open_queue("jobs")).reason == "NO_HOST"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"max_items": 5}, {"max_items": 6}),
        ({"max_items": 5}, {"copies": 2}),
        ({"copies": 1}, {"copies": 2}),
        ({"max_items": 5}, {"lease_nanos": 10**9}),
        ({"max_bytes": 5}, {"max_items": 5}),
        ({"max_items": 5}, {"max_deliveries": 1}),
    ],
)
def test_a_stated_field_that_contradicts_is_refused(log: Log, first: dict[str, Any], second: dict[str, Any]) -> None:
    before = queue(log, "jobs", **first)
    refused = refusal(log, open_queue("jobs", **second))
    assert (refused.reason, refused.metadata["field"]) == ("QUEUE_EXISTS", next(iter(second)))
    assert log.directory.tables.queues.named("jobs") == before


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({}, {"max_items": 6, "copies": 2}),
        ({"copies": 2}, {"lease_nanos": 10**9}),
        ({"max_items": 5}, {"content_type": "text/plain"}),
        ({"max_items": 5}, {"on_full": "block", "lease_nanos": 30 * 10**9, "copies": 1}),
    ],
)
def test_an_unset_field_of_a_policy_is_set_if_this_changes_nothing_for_others(
    log: Log, first: dict[str, Any], second: dict[str, Any]
) -> None:
    queue(log, "jobs", **first)
    after = queue(log, "jobs", **second)
    assert (after.spec, after.spec_version) == (QueueSpec(**first | second), 2)


@pytest.mark.parametrize(
    "spec",
    [
        {"max_items": 0},
        {"max_bytes": 0},
        {"copies": 0},
        {"lease_nanos": 0},
        {"max_deliveries": 0},
        {"max_item_bytes": 16 * 2**20 + 1},
        {"on_full": "explode"},
        {"content_type": "x" * 256},
        {"dead_letter_queue_id": b"short"},
    ],
)
def test_invalid_settings_of_a_queue_are_refused(log: Log, spec: dict[str, Any]) -> None:
    (field,) = spec
    refused = refusal(log, open_queue("jobs", **spec))
    assert (refused.reason, refused.metadata["field"]) == ("INVALID_ARGUMENT", field)


def test_an_update_changes_the_stated_fields_under_the_right_epoch(log: Log) -> None:
    before = queue(log, "jobs", max_items=5)
    assert refusal(log, update_queue(before.queue_id, 2, max_items=6)).reason == "WRONG_EPOCH"
    updated = log.apply(update_queue(before.queue_id, copies=3))
    assert isinstance(updated, QueueUpdated)
    assert (updated.queue.spec, updated.queue.spec_version) == (QueueSpec(max_items=5, copies=3), 2)
    assert log.apply(update_queue(before.queue_id, copies=3)) == updated, "nothing changed, so the version stays"
    assert refusal(log, update_queue(id_of(99))).reason == "QUEUE_NOT_FOUND"


def test_a_dead_letter_queue_must_exist_and_be_no_mailbox(log: Log) -> None:
    refused = refusal(log, open_queue("jobs", dead_letter_queue_id=id_of(99)))
    assert (refused.reason, refused.metadata["queue_id"]) == ("QUEUE_NOT_FOUND", id_of(99).hex())
    log.apply(register_peer(7, "me"))
    (mailbox,) = log.directory.tables.queues.by_id
    assert "mailbox" in refusal(log, open_queue("jobs", dead_letter_queue_id=mailbox)).message
    dead = queue(log, "dead")
    assert queue(log, "jobs", dead_letter_queue_id=dead.queue_id).spec.dead_letter_queue_id == dead.queue_id


def test_dead_letter_queues_cannot_form_a_cycle(log: Log) -> None:
    first = queue(log, "a")
    second = queue(log, "b", dead_letter_queue_id=first.queue_id)
    third = queue(log, "c", dead_letter_queue_id=second.queue_id)
    for last in (first, second, third):
        refused = refusal(log, update_queue(first.queue_id, dead_letter_queue_id=last.queue_id))
        assert (refused.reason, "back to the queue itself" in refused.message) == ("INVALID_ARGUMENT", True)
    assert refusal(log, open_queue("a", dead_letter_queue_id=third.queue_id)).reason == "INVALID_ARGUMENT"


def test_the_length_of_a_chain_of_dead_letter_queues_is_limited(log: Log) -> None:
    last = queue(log, "q0")
    for number in range(transitions.DEAD_LETTER_STEPS_MAX):
        last = queue(log, f"q{number + 1}", dead_letter_queue_id=last.queue_id)
    assert "more than 16" in refusal(log, open_queue("one-more", dead_letter_queue_id=last.queue_id)).message


def test_a_queue_cannot_be_deleted_while_another_uses_it_as_its_dead_letter_queue(log: Log) -> None:
    dead = queue(log, "dead")
    jobs = queue(log, "jobs", dead_letter_queue_id=dead.queue_id)
    refused = refusal(log, delete_queue(dead.queue_id))
    assert (refused.reason, refused.metadata["dead_letter_of"]) == ("INVALID_ARGUMENT", "jobs")
    log.apply(delete_queue(jobs.queue_id))
    log.apply(delete_queue(dead.queue_id))
    assert len(log.directory.tables.queues) == 0


def test_the_name_of_a_deleted_queue_can_be_used_again(log: Log) -> None:
    before = queue(log, "jobs", max_items=5)
    log.apply(delete_queue(before.queue_id))
    assert refusal(log, delete_queue(before.queue_id)).reason == "QUEUE_NOT_FOUND"
    assert refusal(log, open_queue("jobs", create=False)).reason == "QUEUE_NOT_FOUND"
    assert queue(log, "jobs", max_items=6).queue_id != before.queue_id


def test_a_queue_at_another_live_host_than_the_named_one_is_refused(log: Log) -> None:
    queue(log, "jobs", host="one")
    assert queue(log, "jobs", host="one").name == "jobs"
    assert refusal(log, open_queue("jobs", host="two")).reason == "QUEUE_EXISTS"


def test_a_queue_waits_for_its_lost_host_and_gets_another_when_it_is_opened(log: Log) -> None:
    before = queue(log, "jobs", host="one", incarnation=5)
    log.apply(deregister(1))
    assert log.directory.tables.queues.named("jobs") == before
    after = queue(log, "jobs", incarnation=5)
    assert (after.epoch, after.incarnation, after.host_id) == (2, 6, id_of(2))
    assert id_of(1) not in log.directory.tables.hosts, "nothing belongs to the host any more"


def test_a_restarted_host_has_lost_the_messages_of_its_queues(log: Log) -> None:
    before = queue(log, "jobs", host="one")
    log.apply(register(1, name="one", boot=1))
    assert log.directory.tables.queues.named("jobs") == before
    log.apply(register(1, name="one", boot=2, incarnation=901))
    after = log.directory.tables.queues.named("jobs")
    assert after is not None
    assert (after.epoch, after.incarnation, after.host_id) == (2, 901, id_of(1))


def test_a_host_whose_lease_lapsed_keeps_its_queues_until_an_open(log: Log) -> None:
    before = queue(log, "jobs", host="one")
    registered = log.directory.tables.hosts[id_of(1)].registered_index
    log.apply(expire(1, registered_index=registered))
    log.apply(register(1, name="one", boot=1))
    assert queue(log, "jobs") == before


def test_the_number_of_queues_has_a_bound(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transitions, "QUEUES_MAX", 1)
    queue(log, "jobs")
    assert refusal(log, open_queue("more")).reason == "OVERLOADED"
    assert refusal(log, register_peer(7, "me")).reason == "OVERLOADED"
    queue(log, "jobs")


def test_pages_hold_the_matching_queues_and_a_token_for_the_next_page(log: Log) -> None:
    for name in ("a", "b", "b/c", "c"):
        queue(log, name)
    tables = log.directory.tables
    assert [one.name for one in queue_page(tables, "b*", BEGINNING, 0, mailboxes=False).queues] == ["b", "b/c"]
    page = queue_page(tables, "", BEGINNING, 3, mailboxes=True)
    assert page.last == (False, "b/c")
    assert [one.name for one in queue_page(tables, "", page.last, 3, mailboxes=True).queues] == ["c"]


def test_a_snapshot_without_queues_is_read(log: Log) -> None:
    def form(encoded: bytes) -> int:
        return directory_command_pb2.DirectorySnapshot.FromString(encoded).format_version

    old = encode_snapshot(log.directory)
    assert form(old) == 1
    assert len(decode_snapshot(old).tables.queues) == 0
    queue(log, "jobs")
    new = encode_snapshot(log.directory)
    assert form(new) == 3
    assert encode_snapshot(decode_snapshot(new)) == new
