"""A host drops the facts about a channel with the last group of the channel, and looks at no other channel."""

from __future__ import annotations

import asyncio
from typing import Any

from hypothesis import given
from hypothesis import strategies as draws

from stampede_rt.errors import Unavailable
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.observers import ChangeObserver
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.group import ChannelTimes, GroupDefinition
from stampede_rt_channel_host.core.group.times import KnownTimes
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedGroup, ResolvedGroup
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.table import HostedGroups

HOST, NOW, GROUPS = b"h" * 16, 1_000_000, 100


class ScanCounter(dict[bytes, KnownTimes]):
    """Counts the scans of all channels."""

    scans = 0

    def __iter__(self):  # type: ignore[no-untyped-def]  # as dict has it
        self.scans += 1
        return super().__iter__()


def channel(number: int) -> bytes:
    return number.to_bytes(16)


def resolved_group(number: int, *members: int, **settings: Any) -> ResolvedGroup:
    ids = frozenset(channel(one) for one in members)
    definition = GroupDefinition(members=ids, incarnation=1, **settings)
    group = RecordedGroup(group_id=number.to_bytes(16), name=f"g{number}", definition=definition, message=b"")
    records = {
        one: RecordedChannel(
            channel_id=one, name=one.hex(), host_id=HOST, epoch=1, incarnation=1, spec_version=1, policy=Policy(),
            message=b"",
        )
        for one in ids
    }  # fmt: skip
    return ResolvedGroup(group=group, channels=records, targets={HOST: "h:1"}, host_names={HOST: "h"})


def ignored(one: bytes) -> None: ...


async def test_a_group_that_loses_members_deletes_their_state_and_looks_at_no_other_members() -> None:
    table = HostedGroups()
    table.board._known = known = ScanCounter()
    begin = PieceScheduler().begin
    for number in range(GROUPS):
        one = resolved_group(number, number, number + 1)
        table.enter(HostedGroup(one, table.board, lambda: NOW, on_moved=ignored, on_idle=ignored, begin=begin))
        table.board.receive(channel(number), ChannelTimes(1, 1, NOW), 0, NOW)
    known.scans = 0
    table.adopt(table.groups[(7).to_bytes(16)], resolved_group(7, 8))
    assert table.board.find(channel(7)) is not None, "another group has the channel"
    table.forget((6).to_bytes(16))
    assert table.board.find(channel(7)) is None
    assert table.board.find(channel(8)) is not None
    assert known.scans == 0


class ShownGroups:
    """Confirmed groups of the channels 0 to 3, and the times of these channels."""

    def __init__(self) -> None:
        self.table = HostedGroups()
        self.looks = 0

    def group(self, number: int, *members: int, **settings: Any) -> HostedGroup:
        begin = PieceScheduler().begin
        one = HostedGroup(
            resolved_group(number, *members, **settings), self.table.board, lambda: NOW, on_moved=ignored,
            on_idle=ignored, begin=begin,
        )  # fmt: skip
        one.cut.confirm()
        self.table.enter(one)
        self.table.refresh(one)
        return one

    def note(self, number: int, newest: int, end: int | None = None, incarnation: int = 1) -> None:
        times = ChannelTimes(1, incarnation, newest, end)
        self.table.board.enter_own(channel(number), times, NOW)
        for one in self.table.concerned_by(channel(number)):
            self.looks += 1
            self.table.refresh(one)


async def test_a_put_looks_only_at_the_groups_that_it_can_move() -> None:
    """In an earlier version, each put looked at all groups of the channel. 500 groups made a put four times as long."""
    shown = ShownGroups()
    groups = [shown.group(number, 1, 2) for number in range(GROUPS)]
    groups += [shown.group(GROUPS + number, 1, 2, reference=channel(2)) for number in range(GROUPS)]
    shown.note(1, 10)
    shown.note(2, 5)
    shown.looks = 0
    for time in range(11, 21):
        shown.note(1, time)
    assert shown.looks == 0
    shown.note(2, 15)
    assert shown.looks == 2 * GROUPS
    assert {one.cut.cut for one in groups} == {15}


async def test_a_reader_of_changes_gets_each_member_until_it_leaves() -> None:
    shown = ShownGroups()
    one, _ = shown.group(0, 1, 2), shown.group(1, 1, 2)
    shown.note(1, 10)
    shown.note(2, 5)
    reader = ChangeObserver()
    shown.table.observe(one, reader, of_members=True)
    assert shown.table.concerned_by(channel(1)) == [one]
    shown.table.stop_observing(one, reader)
    assert shown.table.concerned_by(channel(1)) == []


async def test_a_deleted_group_holds_no_cut_and_no_channel() -> None:
    shown = ShownGroups()
    one = shown.group(0, 1, 2)
    shown.table.forget(one.record.group_id)
    shown.table.refresh(one)
    shown.table.stop_observing(one, ChangeObserver())
    assert not any(shown.table.concerned_by(channel(number)) for number in (1, 2))


settings_of_groups = draws.fixed_dictionaries(
    {
        "reference": draws.sampled_from([None, channel(0)]),
        "by_end": draws.booleans(),
        "idle_after_nanos": draws.sampled_from([None, None, 10**9]),
    }
)
notes = draws.tuples(
    draws.integers(0, 3), draws.integers(1, 30), draws.none() | draws.integers(1, 40), draws.integers(1, 2)
)


@given(settings=draws.lists(settings_of_groups, min_size=1, max_size=4), scenario=draws.lists(notes, max_size=40))
def test_groups_have_the_same_cuts_as_if_each_change_updated_all_groups(
    settings: list[dict[str, Any]], scenario: list[tuple[int, int, int | None, int]]
) -> None:
    async def compare() -> None:
        shown, all_looked_at = ShownGroups(), ShownGroups()
        some = [shown.group(number, 0, *range(1, 2 + number % 3), **one) for number, one in enumerate(settings)]
        every = [
            all_looked_at.group(number, 0, *range(1, 2 + number % 3), **one) for number, one in enumerate(settings)
        ]
        for member, newest, end, incarnation in scenario:
            shown.note(member, newest, end, incarnation)
            all_looked_at.note(member, newest, end, incarnation)
            for one in every:
                all_looked_at.table.refresh(one)
            assert [one.cut.cut for one in some] == [one.cut.cut for one in every]
        for one in (*some, *every):
            one.end(Unavailable("over"))

    asyncio.run(compare())
