"""What a host knows of a group goes with the last group of each channel, and that looks at no other channel."""

from __future__ import annotations

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.group import ChannelTimes, GroupDefinition
from stampede_rt_channel_host.core.group.times import Heard
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedGroup, ResolvedGroup
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.table import HostedGroups

HOST, NOW, GROUPS = b"h" * 16, 1_000_000, 100


class Walked(dict[bytes, Heard]):
    """Counts how often somebody walks all of it."""

    walks = 0

    def __iter__(self):  # type: ignore[no-untyped-def]  # as dict has it
        self.walks += 1
        return super().__iter__()


def channel(number: int) -> bytes:
    return number.to_bytes(16)


def told(number: int, *members: int) -> ResolvedGroup:
    ids = frozenset(channel(one) for one in members)
    definition = GroupDefinition(members=ids, incarnation=1)
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


async def test_a_group_that_loses_members_forgets_these_and_looks_at_no_others() -> None:
    table = HostedGroups()
    table.board._heard = heard = Walked()
    begin = PieceScheduler().begin
    for number in range(GROUPS):
        one = told(number, number, number + 1)
        table.enter(HostedGroup(one, table.board, lambda: NOW, on_moved=ignored, on_idle=ignored, begin=begin))
        table.board.hear(channel(number), ChannelTimes(1, 1, NOW), 0, NOW)
    heard.walks = 0
    table.adopt(table.groups[(7).to_bytes(16)], told(7, 8))
    assert table.board.find(channel(7)) is not None, "another group has it"
    table.forget((6).to_bytes(16))
    assert table.board.find(channel(7)) is None
    assert table.board.find(channel(8)) is not None
    assert heard.walks == 0
