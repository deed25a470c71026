"""Hosts with an archive in an object store, and owners of a recorded channel at these hosts, in the test's process."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound
from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.disk_use import DiskUse
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.objects import guarded_store, listing_schedule
from stampede_rt_channel_host.archive.objects.object_archive import ObjectArchive, ObjectSettings
from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.recordings import Recordings
from stampede_rt_channel_host.core.archive import WantedItems, WantedWindow
from stampede_rt_channel_host.core.channel import (
    FIRST_KEY,
    ChannelCore,
    Gap,
    Offer,
    Query,
    ReadAnswer,
    Run,
    make_run,
    run_to_end,
)
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY
from stampede_rt_channel_host.core.records import RecordedChannel
from tests.support.channel_host.object_stores import CHANNEL

EVERYTHING = WantedWindow(WantedItems(FIRST_KEY[0], LAST_KEY, 0, 2**30), FIRST_KEY, LAST_KEY)


@pytest.fixture
def no_pauses_after_failures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the hosts ask a failing store again without a pause."""
    monkeypatch.setattr(guarded_store, "PAUSE_SECONDS", 0.0)
    monkeypatch.setattr(listing_schedule, "WAIT_SECONDS_MIN", 0.0)


def record(epoch: int) -> RecordedChannel:
    return RecordedChannel(
        channel_id=CHANNEL, name="cam", policy=Policy(archive_nanos=10**18), host_id=b"h" * 16, epoch=epoch,
        incarnation=epoch, spec_version=1, message=b"",
    )  # fmt: skip


def decode(body: bytes) -> Run:
    """A run of one item. `body`: its seq, or its seq and its time with a colon between them."""
    seq, _, time = body.partition(b":")
    return make_run(int(seq), [int(time or seq)], None, [7], body)


class Host:
    """One host with an archive. The payload of each item is its seq, as text."""

    def __init__(self, path: Path, store: SegmentStore | None, bytes_max: int = 2**30) -> None:
        """`store`: None: the archive is only in the folder."""
        folder = ArchiveFolder(path)
        folder.open(b"h" * 16)
        self.path, self.clock = path, 0
        objects = None
        if store is not None:
            objects = ObjectArchive(ObjectSettings(store, 2**20, 60), folder, slice_run, lambda: self.clock)
            self.mover = objects.mover
        self.disk = DiskUse(bytes_max)
        self.archive = HostArchive(folder, decode, self.disk, lambda: self.clock, objects)

    async def serve(self, epoch: int, next_seq: int = 1) -> ChannelRecorder:
        """Record the channel here. `next_seq`: the next seq of a channel that has moved here without items."""
        files, found = await self.archive.open(record(epoch))
        channel = ChannelCore(Policy(max_items=4), incarnation=epoch)
        next_seq = max(next_seq, *(one.end_seq for one in found.segments), 1)
        channel.restore((), after=None, next_seq=next_seq, loss=(0, 0))
        disk = self.disk.of_channel(CHANNEL, "")
        recorder = ChannelRecorder(channel, files, found.segments, disk)
        self.archive.record(recorder)
        self.channel, self.recorder = channel, recorder
        return recorder

    async def write(self, count: int = 1) -> None:
        """Accept items, write them, and let time pass until the host closes the file."""
        for _ in range(count):
            self.clock += 1
            self.recorder.check_room(7)
            offer = Offer(times=[self.channel.next_seq], durations=None, lengths=[7])
            self.channel.put(offer, self.clock, lambda first_seq, kept, stamped: b"%d" % first_seq)
            self.recorder.note(self.clock)
        self.archive.touch(self.recorder, lambda: None)
        await self.archive.write_all()
        self.clock += 61 * 10**9

    def read(self) -> list[int]:
        window = self.recorder.files.load(self.recorder.segments, EVERYTHING, decode, lambda: None)
        return [one.first_seq for one in window.items.slices(FIRST_KEY, LAST_KEY)]

    def local(self) -> list[str]:
        return [path.name for path in (self.path / "channels").rglob("*.segment")]

    async def close(self) -> None:
        await self.archive.close([self.recorder] if hasattr(self, "recorder") else [], 0)


@asynccontextmanager
async def host(path: Path, store: SegmentStore | None, bytes_max: int = 2**30) -> AsyncIterator[Host]:
    one = Host(path, store, bytes_max)
    try:
        yield one
    finally:
        await one.close()


class Owner:
    """An owner of the channel, which serves it as a host does."""

    gaps: list[Gap]
    """The gaps of the last subscription, see `subscribed`."""

    def __init__(self, one: Host, epoch: int = 2) -> None:
        self.host, self.epoch = one, epoch
        self.recordings = Recordings()
        self.recordings.archive = one.archive

    async def serve(self, **policy: Any) -> Owner:
        found = record(self.epoch)
        found = replace(found, policy=replace(found.policy, **{"max_future_nanos": 0, **policy}))
        return self.keep(
            await self.recordings.adopt(found, None, lambda one: HostedChannel(one, MemoryBudget(2**30), self.now))
        )

    def keep(self, hosted: HostedChannel) -> Owner:
        """Own this channel."""
        self.hosted = hosted
        assert hosted.recording is not None
        self.recording = hosted.recording
        self.host.recorder = self.recording.recorder
        return self

    def now(self) -> int:
        return self.host.clock

    async def put(self, *times: int, at: int | None = None) -> None:
        """Accept items with these times, and write them. The host accepts each at its time, or all at the time `at`."""
        for time in times:
            self.host.clock = max(self.host.clock + 1, time) if at is None else at
            offer = Offer(times=[time], durations=None, lengths=[7])
            self.hosted.core.put(offer, self.now(), lambda seq, kept, stamped, time=time: b"%d:%d" % (seq, time))
            self.hosted.changed(self.now())
        await self.host.archive.write_all()

    async def find(self) -> None:
        """Let the host do its due work at the store, which must not fail, and write all changes to the disk."""
        assert not await self.host.mover.move_all()
        await self.host.archive.write_all()

    async def read(self, query: Query) -> ReadAnswer:
        if self.recording.reaches(query, self.now()):
            return (await self.recording.read(query, None, PieceScheduler(), self.now)).answer()
        return self.hosted.channel.read(query, self.now())

    async def times(self, query: Query) -> list[int]:
        return [time for one in (await self.read(query)).slices for time in one.run.times[one.lo : one.hi]]

    async def subscribed(self, start: Bound) -> tuple[list[int], int]:
        """The times of the items that a subscription gets, and the number of items that it dropped."""
        self.gaps = list[Gap]()
        lost_at = await self.recording.losses.places({"start": start}, self.now())
        where = self.recording.beginning({"start": start}, self.now())
        cursor = run_to_end(self.hosted.channel.subscribing_all(self.now(), **where, lost_at=lost_at))
        times: list[int] = []
        for _ in range(40):
            batch = await self.recording.since(cursor, 2**20, self.now)
            batch = self.hosted.channel.since(cursor, self.now(), 2**20) if batch is None else batch
            self.gaps += [] if batch.gap is None else [batch.gap]
            times += [time for one in batch.slices for time in one.slice.run.times[one.slice.lo : one.slice.hi]]
        return times, cursor.dropped
