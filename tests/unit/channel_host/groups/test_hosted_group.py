"""A group with very many readers wakes, releases and ends a few of them in each turn of the event loop."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

import pytest

from stampede_rt.errors import IncarnationLost, StampedeError, Unavailable
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.observers import OBSERVERS_PER_PIECE, ChangeObserver
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.group import ChannelTimes, GroupDefinition, TimesBoard
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedGroup, ResolvedGroup
from stampede_rt_channel_host.groups.hosted_group import HostedGroup

MANY, NOW = 4 * OBSERVERS_PER_PIECE, 1_000_000
MEMBER, HOST = b"m" * 16, b"h" * 16


class Reader(ChangeObserver):
    def __init__(self) -> None:
        super().__init__()
        self.woken = 0
        self.error: StampedeError | None = None

    def wake(self) -> None:
        self.listen()
        self.woken += 1

    def end(self, error: StampedeError) -> None:
        self.error = error


def defined_group(incarnation: int = 1) -> ResolvedGroup:
    definition = GroupDefinition(members=frozenset([MEMBER]), incarnation=incarnation)
    group = RecordedGroup(group_id=b"g" * 16, name="pair", definition=definition, message=b"")
    channel = RecordedChannel(
        channel_id=MEMBER, name="a", host_id=HOST, epoch=1, incarnation=1, spec_version=1, policy=Policy(), message=b""
    )
    return ResolvedGroup(group=group, channels={MEMBER: channel}, targets={HOST: "h:1"}, host_names={HOST: "h"})


class GroupRig:
    """The group, and its one member's times, which a test moves on."""

    def __init__(self) -> None:
        self.board = TimesBoard()
        self.group = HostedGroup(
            defined_group(), self.board, lambda: NOW, on_moved=_ignore, on_idle=_ignore, begin=PieceScheduler().begin
        )
        self.group.cut.confirm()

    def move_to(self, time: int) -> None:
        self.board.enter_own(MEMBER, ChannelTimes(1, 1, time), NOW)
        self.group.changed()


def _ignore(one: bytes) -> None: ...


async def turns(count: Callable[[], int]) -> list[int]:
    """The results of `count` after each turn of the event loop, until they no longer change."""
    counts = [count()]
    while len(counts) < 6 or counts[-1] != counts[-6]:
        await asyncio.sleep(0)
        counts.append(count())
    return counts


def most(counts: list[int]) -> int:
    return max(after - before for before, after in itertools.pairwise(counts))


async def test_a_cut_that_moves_wakes_a_few_readers_in_a_turn() -> None:
    hosted = GroupRig()
    readers = [Reader() for _ in range(MANY)]
    for reader in readers:
        hosted.group.cut_observers.add(reader)
    hosted.move_to(7)
    counts = await turns(lambda: sum(one.woken for one in readers))
    assert (counts[0], most(counts), counts[-1]) == (OBSERVERS_PER_PIECE, OBSERVERS_PER_PIECE, MANY)


async def test_a_cut_that_moves_releases_a_few_waiting_calls_in_each_turn() -> None:
    hosted, released = GroupRig(), 0

    async def wait() -> None:
        nonlocal released
        assert await hosted.group.reach(7, None)
        released += 1

    waiting = [asyncio.create_task(wait()) for _ in range(MANY)]
    await asyncio.sleep(0)
    cancelled = waiting.pop()
    cancelled.cancel()
    hosted.move_to(7)
    counts = await turns(lambda: released)
    assert most(counts) == OBSERVERS_PER_PIECE
    await asyncio.gather(*waiting)
    assert released == MANY - 1


async def test_an_end_is_reported_to_a_few_in_a_turn() -> None:
    hosted = GroupRig()
    readers = [Reader() for _ in range(MANY)]
    for reader in readers[::2]:
        hosted.group.cut_observers.add(reader)
    for reader in readers[1::2]:
        hosted.group.member_observers.add(reader)
    waiting = [asyncio.create_task(hosted.group.reach(9, None)) for _ in range(MANY)]
    await asyncio.sleep(0)
    hosted.group.end(Unavailable("gone"))
    counts = await turns(
        lambda: sum(one.error is not None for one in readers) + sum(one.done() for one in waiting),
    )
    assert most(counts) <= 2 * OBSERVERS_PER_PIECE
    assert counts[-1] == 2 * MANY
    assert {str(one.exception()) for one in waiting} == {"gone"}


async def test_a_reader_of_the_former_incarnation_of_a_group_reads_nothing_of_the_new_one() -> None:
    hosted = GroupRig()
    incarnation = hosted.group.record.incarnation
    hosted.group.check_incarnation(incarnation)
    hosted.group.adopt(defined_group(incarnation=2))
    with pytest.raises(IncarnationLost, match="group pair began anew"):
        hosted.group.check_incarnation(incarnation)
