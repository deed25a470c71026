"""The commands of groups, in a directory in memory."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt.v1 import directory_command_pb2
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.commands import Operation, RefusedOperation
from stampede_rt_supernode.core.groups import transitions as group_transitions
from stampede_rt_supernode.core.groups.commands import GroupOpened, GroupUpdated
from stampede_rt_supernode.core.groups.queries import group_page, group_view
from stampede_rt_supernode.core.records import GroupRecord
from tests.support.supernode.operations import (
    Log,
    delete,
    delete_group,
    deregister,
    id_of,
    open_channel,
    open_group,
    register,
    update_group,
)


@pytest.fixture
def log() -> Log:
    log = Log()
    log.apply(register(1, name="one"))
    log.apply(register(2, name="two"))
    return log


def channel(log: Log, name: str, host: str = "") -> bytes:
    opened = log.apply(open_channel(name, host=host))
    assert isinstance(opened, ChannelOpened), opened
    return opened.channel.channel_id


def group(log: Log, name: str, *members: bytes, incarnation: int = 88, **spec: Any) -> GroupRecord:
    opened = log.apply(open_group(name, members, incarnation=incarnation, **spec))
    assert isinstance(opened, GroupOpened), opened
    return opened.group


def refusal(log: Log, operation: Operation) -> RefusedOperation:
    result = log.apply(operation)
    assert isinstance(result, RefusedOperation)
    return result


def test_the_first_of_two_creators_wins_and_the_other_gets_the_same_group(log: Log) -> None:
    left, right = channel(log, "left"), channel(log, "right")
    first = log.apply(open_group("pair", (left, right)))
    second = log.apply(open_group("pair", (right, left), max_lead_nanos=5 * 10**9))
    assert isinstance(first, GroupOpened)
    assert second == GroupOpened(group=first.group, created=False)
    assert first.created


@pytest.mark.parametrize("spec", [{"bound": "end"}, {"idle_after_nanos": 1}, {"max_lead_nanos": 0}], ids=str)
def test_a_creator_of_another_group_of_that_name_is_refused(log: Log, spec: dict[str, Any]) -> None:
    left = channel(log, "left")
    group(log, "pair", left)
    refused = refusal(log, open_group("pair", (left,), **spec))
    assert refused.reason == "GROUP_EXISTS"
    assert "other members or settings" in refused.message


def test_a_group_can_be_opened_without_settings_only_if_it_exists(log: Log) -> None:
    assert refusal(log, open_group("pair", None, create=False)).reason == "GROUP_NOT_FOUND"
    assert refusal(log, open_group("pair", None)).reason == "INVALID_ARGUMENT"
    made = group(log, "pair", channel(log, "left"))
    assert log.apply(open_group("pair", None, create=False)) == GroupOpened(group=made, created=False)


def test_the_members_of_a_new_group_must_exist(log: Log) -> None:
    assert refusal(log, open_group("pair", (id_of(99),))).reason == "CHANNEL_NOT_FOUND"
    made = group(log, "pair", channel(log, "left"))
    assert refusal(log, update_group(made.group_id, add=(id_of(99),))).reason == "CHANNEL_NOT_FOUND"


def test_invalid_settings_of_a_group_are_refused(log: Log) -> None:
    left = channel(log, "left")
    for operation in (
        open_group("pair", ()),
        open_group("pair", (left, left)),
        open_group("pair", (left,), reference_channel_id=id_of(99)),
        open_group("pair", (left,), idle_after_nanos=0),
        open_group("pair", (left,), max_lead_nanos=-1),
        open_group("pair", tuple(id_of(number) for number in range(65))),
    ):
        refused = refusal(log, operation)
        assert refused.reason == "INVALID_ARGUMENT"
        assert "group pair" in refused.message


def test_an_added_or_removed_member_raises_the_version_of_the_group(log: Log) -> None:
    left, right, top = (channel(log, name) for name in ("left", "right", "top"))
    made = group(log, "rig", left, right)
    changed = log.apply(update_group(made.group_id, add=(top, left), remove=(right, id_of(99)), version=1))
    assert isinstance(changed, GroupUpdated)
    assert changed.group.spec.channel_ids == (left, top)
    assert changed.group.spec_version == 2
    assert log.apply(update_group(made.group_id, add=(top,))) == changed, "the repeated update changes nothing"
    late = refusal(log, update_group(made.group_id, add=(right,), version=1))
    assert (late.reason, late.metadata["spec_version"]) == ("GROUP_EXISTS", "2")


def test_the_reference_and_the_last_member_cannot_be_removed(log: Log) -> None:
    left, right = channel(log, "left"), channel(log, "right")
    made = group(log, "pair", left, right, reference_channel_id=left)
    assert "reference" in refusal(log, update_group(made.group_id, remove=(left,))).message
    assert "0 members" in refusal(log, update_group(made.group_id, remove=(left, right))).message
    both = refusal(log, update_group(made.group_id, add=(left,), remove=(left,)))
    assert "is in both lists, to add and to remove" in both.message


def test_the_name_of_a_deleted_group_can_be_used_again_and_its_channels_are_kept(log: Log) -> None:
    left = channel(log, "left")
    made = group(log, "pair", left)
    log.apply(delete_group(made.group_id))
    assert refusal(log, delete_group(made.group_id)).reason == "GROUP_NOT_FOUND"
    assert left in log.directory.tables.channels
    assert group(log, "pair", left).group_id != made.group_id


def test_a_deleted_channel_leaves_its_groups(log: Log) -> None:
    left, right = channel(log, "left"), channel(log, "right")
    made = group(log, "pair", left, right)
    log.apply(delete(left))
    now = log.directory.tables.groups.by_id[made.group_id]
    assert (now.spec.channel_ids, now.spec_version) == ((right,), 2)


def test_a_group_is_deleted_with_its_reference_or_its_last_member(log: Log) -> None:
    left, right = channel(log, "left"), channel(log, "right")
    group(log, "led", left, right, reference_channel_id=left)
    group(log, "alone", left)
    log.apply(delete(left))
    assert len(log.directory.tables.groups) == 0


def test_a_group_begins_anew_only_when_all_hosts_of_its_members_have_restarted(log: Log) -> None:
    made = group(log, "pair", channel(log, "left", "one"), channel(log, "right", "two"), incarnation=50)

    def incarnation() -> int:
        return log.directory.tables.groups.by_id[made.group_id].incarnation

    log.apply(register(1, name="one", boot=2))
    assert incarnation() == 50
    log.apply(register(1, name="one", boot=3))
    assert incarnation() == 50, "the other host still knows the cut"
    log.apply(register(2, name="two", boot=2))
    assert incarnation() == 51
    log.apply(register(1, name="one", boot=4))
    assert incarnation() == 51, "the count begins anew with the incarnation"


def test_a_group_whose_only_channel_is_placed_anew_begins_anew(log: Log) -> None:
    made = group(log, "alone", channel(log, "left", "one"), incarnation=2**64 - 1)
    log.apply(deregister(1))
    assert log.directory.tables.groups.by_id[made.group_id].incarnation == 2**64 - 1, "the host may come back"
    log.apply(open_channel("left"))
    assert log.directory.tables.groups.by_id[made.group_id].incarnation == 1, "0 is no incarnation"


def test_the_number_of_groups_is_bounded(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = channel(log, "left"), channel(log, "right")
    made = group(log, "first", left)
    monkeypatch.setattr(group_transitions, "GROUPS_PER_CHANNEL_MAX", 1)
    assert refusal(log, open_group("second", (left,))).reason == "OVERLOADED"
    group(log, "second", right)
    assert refusal(log, update_group(made.group_id, add=(right,))).reason == "OVERLOADED"
    monkeypatch.setattr(group_transitions, "GROUPS_MAX", 2)
    refused = refusal(log, open_group("third", (channel(log, "top"),)))
    assert (refused.reason, refused.metadata["group"]) == ("OVERLOADED", "third")


def test_a_view_of_an_older_group_has_no_deleted_channels(log: Log) -> None:
    left, right = channel(log, "left", "one"), channel(log, "right", "two")
    before = group(log, "pair", left, right)
    log.apply(delete(left))
    view = group_view(log.directory.tables, before)
    assert [one.name for one in view.channels] == ["right"]
    assert [one.name for one in view.hosts] == ["two"]


def test_groups_are_listed_by_pattern_by_channel_and_in_pages(log: Log) -> None:
    left, right = channel(log, "left"), channel(log, "right")
    for name, members in (("a/1", (left,)), ("a/2", (left, right)), ("b", (right,)), ("a/3", (left,))):
        group(log, name, *members)

    def names(glob: str = "", of: bytes = b"", after: str = "", most: int = 0) -> tuple[list[str], str | None]:
        page = group_page(log.directory.tables, glob, of, after, most)
        return [one.name for one in page.groups], page.last_name

    assert names() == (["a/1", "a/2", "a/3", "b"], None)
    assert names("a/*", most=2) == (["a/1", "a/2"], "a/2")
    assert names("a/*", after="a/2", most=2) == (["a/3"], None)
    assert names(of=right) == (["a/2", "b"], None)
    assert names("a*", of=right, after="a/1") == (["a/2"], None)


def test_a_snapshot_without_groups_and_copies_has_the_bytes_of_earlier_releases(log: Log) -> None:
    left = channel(log, "left")

    def version() -> int:
        encoded = encode_snapshot(log.directory)
        assert encode_snapshot(decode_snapshot(encoded)) == encoded
        return directory_command_pb2.DirectorySnapshot.FromString(encoded).format_version

    assert version() == 1
    made = group(log, "pair", left)
    assert version() == 2
    log.apply(delete_group(made.group_id))
    assert version() == 1


def test_a_group_does_not_copy_the_ids_of_its_channels(log: Log) -> None:
    """In an earlier version, each group kept copies.

    A caller that made and deleted groups filled the memory of the supernode with copies.
    """
    left, right = channel(log, "left"), channel(log, "right")
    made = group(log, "pair", bytes(bytearray(left)))
    changed = log.apply(update_group(made.group_id, add=(bytes(bytearray(right)),)))
    assert isinstance(changed, GroupUpdated)
    kept = {id(record.channel_id) for record in log.directory.tables.channels.values()}
    assert {id(one) for one in changed.group.spec.channel_ids} == kept
