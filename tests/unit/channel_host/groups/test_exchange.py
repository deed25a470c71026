"""A host asks other hosts for the channels of its groups. When one group changes, it looks at no other group."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.group import GroupDefinition
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedGroup, ResolvedGroup
from stampede_rt_channel_host.groups.exchange import TimesExchange
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.link import INTEREST_MAX
from stampede_rt_channel_host.groups.sharing_hosts import SharingHosts
from stampede_rt_channel_host.groups.table import HostedGroups

OWN, LEFT, RIGHT = b"o" * 16, b"l" * 16, b"r" * 16


class ScanCounter(dict[bytes, HostedGroup]):
    """Counts the scans of all groups."""

    scans = 0

    def __iter__(self):  # type: ignore[no-untyped-def]  # as dict has it
        self.scans += 1
        return super().__iter__()

    def items(self):  # type: ignore[no-untyped-def]  # as dict has it
        self.scans += 1
        return super().items()


class Groups:
    """An exchange, and groups whose members belong to the named hosts."""

    def __init__(self) -> None:
        self.table = HostedGroups()
        self.table.groups = self.scanned = ScanCounter()
        identity: Any = SimpleNamespace(host_id=OWN, name="own")
        channels: Any = SimpleNamespace(scheduler=PieceScheduler(), lease_held=lambda: True, now=lambda: 0)
        dial: Any = None
        self.exchange = TimesExchange(
            identity, channels, self.table, dial, lambda: "", on_stale=lambda _: None, on_requested=lambda _: None
        )

    def adopt(self, number: int, *members: tuple[int, bytes], creator: str = "") -> None:
        """Process the directory's record of a group. `members`: the number and the owner of each channel."""
        resolved = resolved_group(number, *members, creator=creator)
        held = self.table.groups.get(resolved.group.group_id)
        if held is None:
            begin = PieceScheduler().begin
            self.table.enter(
                HostedGroup(
                    resolved, self.table.board, lambda: 0, on_moved=lambda _: None, on_idle=lambda _: None, begin=begin
                )
            )
        else:
            self.table.adopt(held, resolved)
        self.exchange.share(resolved.group.group_id)

    def forget(self, number: int) -> None:
        self.table.forget(number.to_bytes(16))
        self.exchange.share(number.to_bytes(16))

    def wanted(self, host_id: bytes) -> set[int]:
        return {int.from_bytes(one) for one in self.exchange.sharing_hosts.wanted_of(host_id)}


def resolved_group(number: int, *members: tuple[int, bytes], creator: str) -> ResolvedGroup:
    records = {
        channel.to_bytes(16): RecordedChannel(
            channel_id=channel.to_bytes(16), name=f"c{channel}", host_id=host_id, epoch=1, incarnation=1,
            spec_version=1, policy=Policy(), message=b"",
        )
        for channel, host_id in members
    }  # fmt: skip
    definition = GroupDefinition(members=frozenset(records), incarnation=1)
    group = RecordedGroup(
        group_id=number.to_bytes(16), name=f"g{number}", definition=definition, message=b"", created_by=creator
    )
    hosts = {host_id for _, host_id in members}
    return ResolvedGroup(
        group=group, channels=records, targets=dict.fromkeys(hosts, "h:1"), host_names=dict.fromkeys(hosts, "h")
    )


@pytest.fixture
def groups(monkeypatch: pytest.MonkeyPatch) -> Groups:
    async def keep(_: SharingHosts, _other: object) -> None:
        await asyncio.Event().wait()

    monkeypatch.setattr(SharingHosts, "_keep", keep)
    return Groups()


async def test_a_host_follows_the_channels_of_all_groups_until_the_last_group_is_deleted(groups: Groups) -> None:
    groups.adopt(1, (1, LEFT), (2, RIGHT), (3, OWN))
    groups.adopt(2, (2, RIGHT), (4, RIGHT))
    assert (groups.wanted(LEFT), groups.wanted(RIGHT), groups.wanted(OWN)) == ({1}, {2, 4}, set())
    assert groups.exchange.name_of_host(LEFT) == "h"
    groups.adopt(1, (1, RIGHT), (3, OWN))
    assert (groups.wanted(LEFT), groups.wanted(RIGHT)) == (set(), {1, 2, 4})
    assert groups.exchange.name_of_host(LEFT) == ""
    groups.forget(1)
    assert groups.wanted(RIGHT) == {2, 4}
    groups.forget(2)
    assert groups.wanted(RIGHT) == set()
    groups.adopt(3, (7, LEFT))
    assert groups.wanted(LEFT) == {7}


async def test_a_host_that_learns_of_a_group_looks_at_no_other_group(groups: Groups) -> None:
    for number in range(100):
        groups.adopt(number, (number, LEFT), (number + 1, RIGHT))
    assert groups.scanned.scans == 0
    assert groups.wanted(LEFT) == {*range(100)}


async def test_many_groups_of_one_caller_do_not_displace_the_channels_of_others(
    groups: Groups, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(0, INTEREST_MAX + 2000, 64):
        groups.adopt(number, *((channel, LEFT) for channel in range(number, number + 64)), creator="hostile")
    good = 1_000_000  # an id after all others
    groups.adopt(good, (good, LEFT), (good + 1, LEFT), creator="good")
    assert {good, good + 1} <= groups.wanted(LEFT)
    assert len(groups.wanted(LEFT)) == INTEREST_MAX
    [warning] = [one for one in caplog.records if getattr(one, "event", "") == "group_too_large"]
    assert (warning.__dict__["created_by"], warning.__dict__["most"]) == ("hostile", INTEREST_MAX)
    for number in range(0, INTEREST_MAX + 2000, 64):
        groups.forget(number)
    assert groups.wanted(LEFT) == {good, good + 1}
