"""Items that leave memory before the archive has them, as readers of a group see them."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import cast

import pytest

from stampede_rt.values.timeline import OLDEST, Bound
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.group import Horizon
from stampede_rt_channel_host.groups.recorded_subscriptions import resolved_start
from tests.support.waiting import until
from tests.unit.channel_host.archive.test_host_archive_writes import refuse
from tests.unit.channel_host.channels.test_recording_backlog import (
    CLOCK,
    LARGEST,
    RecordedChannel,
    put_during_a_write,
    recorded_channel,
)


class Shell:
    """The parts of a host that the first step of a subscription needs."""

    def __init__(self, one: RecordedChannel) -> None:
        self.recording = one.recording
        self.scheduler = PieceScheduler()

    def now(self) -> int:
        return CLOCK


async def test_a_read_through_a_group_names_the_items_that_memory_has_lost_before_the_first_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        with monkeypatch.context() as fault:
            fault.setattr(one.recording.recorder.files, "write", refuse)
            one.put(5)  # memory holds the seqs 7 to 10
            await until(lambda: bool(one.recording.recorder.failure))
            for newest_first in (False, True):
                assert await one.read_in_group(5, newest_first=newest_first) == ([], "LOST")
                assert await one.read_in_group(9, newest_first=newest_first) == ([7, 8], "LOST")
        await until(lambda: not one.recording.recorder.backlog_items)
        assert await one.read_in_group(5) == ([], "LOST")


@pytest.mark.parametrize("cut", [5, CLOCK])
async def test_a_read_through_a_group_waits_for_the_first_write_of_items_that_have_left_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: int
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        disk = await put_during_a_write(one, monkeypatch)
        reading = asyncio.create_task(one.read_in_group(cut))
        await asyncio.sleep(0)
        disk.may_continue.set()
        found, reason = await reading
        assert found == [*range(1, min(cut, one.channel.next_seq))]
        assert reason == ("HIDDEN" if cut == 5 else None)


@pytest.mark.parametrize("cut", [None, CLOCK])
async def test_a_subscription_through_a_group_begins_with_the_items_of_the_first_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: int | None
) -> None:
    """Also if the group shows no item yet when the subscription begins to wait, and shows some afterwards."""
    async with recorded_channel(tmp_path, monkeypatch) as one:
        disk, shell = await put_during_a_write(one, monkeypatch), Shell(one)
        horizons = [Horizon(cut, lambda: "")]
        hosted, channels = cast("HostedChannel", shell), cast("ChannelStore", shell)
        beginning = asyncio.create_task(resolved_start(hosted, channels, lambda: horizons[-1], OLDEST))
        await asyncio.sleep(0)
        horizons.append(Horizon(CLOCK, lambda: ""))
        disk.may_continue.set()
        assert await beginning == Bound(None, 1)


async def test_a_slow_reader_of_a_group_waits_for_the_write_of_items_that_have_left_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with recorded_channel(tmp_path, monkeypatch) as one:
        disk = await put_during_a_write(one, monkeypatch)
        reading = asyncio.create_task(one.recording.items_from((1, 9), LARGEST, lambda: CLOCK))
        await asyncio.sleep(0)
        disk.may_continue.set()
        items, _, end = await reading
        assert next(part.first_seq for part in items) == 1
        assert end >= 5
