"""The recorded channels of a host: a host without an archive, and a channel that moves here from another host."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.values.seq_starts import given_over, start_of
from stampede_rt.values.timeline import Bound, Interval
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.recordings import Recordings
from stampede_rt_channel_host.core.channel import Offer, Query, make_run
from stampede_rt_channel_host.core.records import RecordedChannel
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.recorded_hosts import Host, Owner, host, no_pauses_after_failures, record  # noqa: F401


def test_a_host_without_an_archive_refuses_a_recorded_channel_with_its_name_and_advice() -> None:
    recordings = Recordings()
    recordings.check("rig/imu", is_recorded=False)
    with pytest.raises(InvalidArgument, match=r"rig/imu is to be recorded .* with an archive \(--archive FOLDER"):
        recordings.check("rig/imu", is_recorded=True)


def moved_record(epoch: int) -> RecordedChannel:
    return replace(record(epoch), incarnation=1)


async def take_over(new: Host, next_seq: int, held: Sequence[int] = ()) -> HostedChannel:
    """Take the channel over as a move does: open the archive before the directory commits the move, and record the
    channel after it.

    `held`: the seqs in memory. Each item has its seq as its time.
    """
    runs = [make_run(seq, [seq], None, [7], b"%d" % seq) for seq in held]
    recordings = Recordings()
    recordings.archive = new.archive
    await recordings.prepare_move(moved_record(1), next_seq)
    hosted = HostedChannel(moved_record(2), MemoryBudget(2**30), lambda: new.clock)
    hosted.core.restore(runs, after=None, next_seq=next_seq, loss=(None, None))
    hosted.begin_move()
    hosted = await recordings.adopt(moved_record(2), None, lambda _: hosted)
    assert hosted.recording is not None
    new.recorder = hosted.recording.recorder
    return hosted


async def finish(former: Host, new: Host) -> None:
    """The new owner writes its items, and then the former owner moves its last file."""
    await new.archive.write_all()
    former.archive.forget(former.recorder)
    del former.recorder
    assert not await former.mover.move_all()
    new.mover._listings.hurry()
    assert not await new.mover.move_all()


@pytest.mark.asyncio
async def test_the_new_owner_numbers_its_files_by_its_own_epoch_and_reads_the_last_file_of_the_former_one(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    async with host(tmp_path / "a", store) as former, host(tmp_path / "b", store) as new:
        await former.serve(1)
        await former.write()
        await former.mover.move_all()
        await former.write()  # this file is on the disk of the former owner when the channel moves
        hosted = await take_over(new, 3)
        hosted.core.put(Offer(times=[3], durations=None, lengths=[7]), 1, lambda first_seq, kept, stamped: b"3")
        hosted.changed(1)
        await finish(former, new)
        assert new.read() == [1, 2, 3]


@pytest.mark.parametrize("held", [[2, 4], [2, 3]])
@pytest.mark.asyncio
async def test_an_item_that_memory_dropped_out_of_order_stays_in_the_archive_after_a_move(
    tmp_path: Path, held: list[int]
) -> None:
    store = FakeStore()
    async with host(tmp_path / "a", store) as former, host(tmp_path / "b", store) as new:
        await former.serve(1)
        await former.write()
        await former.mover.move_all()
        await former.write(3)
        hosted = await take_over(new, 5, held)
        hosted.core.put(Offer(times=[5], durations=None, lengths=[7]), 1, lambda first_seq, kept, stamped: b"5")
        hosted.changed(1)
        await finish(former, new)
        assert new.read() == [1, 2, 3, 4, 5]


async def serve_one_item(path: Path, store: FakeStore, epoch: int, time: int) -> None:
    """Own the channel in this epoch, accept an item, and stop cleanly."""
    one = Host(path, store)
    one.clock = time
    owner = await Owner(one, epoch).serve()
    await owner.put(time)
    await owner.recordings.close(0)


@pytest.mark.usefixtures("no_pauses_after_failures")
@pytest.mark.parametrize("first_epoch", [1, 2])
@pytest.mark.asyncio
async def test_a_host_does_not_trust_its_list_of_objects_if_the_channel_moves_back(
    tmp_path: Path, first_epoch: int
) -> None:
    """In an earlier version the host trusted its own list, and did not know the objects of the present owner."""
    store = FakeStore()
    if first_epoch > 1:
        await serve_one_item(tmp_path / "a", store, 1, 10)
    async with host(tmp_path / "b", store) as present, host(tmp_path / "a", store) as former:
        await present.serve(first_epoch)
        await present.write(3)
        await present.mover.move_all()
        store.failure = "unreachable"
        recordings = Recordings()
        recordings.archive = former.archive
        with pytest.raises(Unavailable, match="cannot be used"):
            await recordings.prepare_move(record(first_epoch), present.channel.next_seq)
        store.failure = ""
        await recordings.prepare_move(record(first_epoch), present.channel.next_seq)
        opened = recordings._opened[record(1).channel_id].found
        assert opened.segments[-1].end_seq == present.channel.next_seq
        assert opened.stop is None


@pytest.mark.asyncio
async def test_a_move_back_keeps_the_losses_and_the_advance_that_the_present_owner_knows(tmp_path: Path) -> None:
    """In an earlier version, if the channel had no items, the notes of the former stop replaced what the owner knew."""
    one = Host(tmp_path, FakeStore())
    recording = (await Owner(one, 1).serve()).hosted
    recording.advance(0)
    await one.archive.write_all()
    await one.archive.close([one.recorder], 0)
    async with host(tmp_path, FakeStore()) as former:
        recordings = Recordings()
        recordings.archive = former.archive
        await recordings.prepare_move(record(2), 1)
        hosted = HostedChannel(replace(record(2), epoch=3), MemoryBudget(2**30), lambda: former.clock)
        hosted.core.restore((), after=None, next_seq=1, loss=(4, 5), advance=3)
        hosted.begin_move()
        hosted = await recordings.adopt(replace(record(2), epoch=3), None, lambda _: hosted)
        assert (hosted.core.lost_from, hosted.core.lost_before, hosted.core.advanced_to) == (4, 5, 3)
        assert hosted.recording is not None
        former.recorder = hosted.recording.recorder


async def lost(path: Path, store: FakeStore | None, epoch: int, *times: int) -> None:
    """Own the channel in this epoch, accept items, and crash before the file with them has moved."""
    one = Host(path, store)
    owner = await Owner(one, epoch).serve()
    await owner.put(*times)
    assert owner.recording.recorder.files._file is not None
    owner.recording.recorder.files._end_segment()
    one.archive._writer.shutdown()
    one.archive.folder.close()


@pytest.mark.usefixtures("no_pauses_after_failures")
@pytest.mark.asyncio
async def test_items_of_lost_owners_that_come_to_the_store_later_are_all_there(tmp_path: Path) -> None:
    """In an earlier version, an owner that did not find some items in the store gave their seqs to new items. The items
    of one owner then hid the items of the other, and reads said COLLECTED for the hidden ones.
    """
    store = FakeStore()
    await lost(tmp_path / "a", store, 1, 10, 11, 12)
    await lost(tmp_path / "b", store, 2, 20, 21)
    async with host(tmp_path / "a", store) as first, host(tmp_path / "b", store) as second:
        second.clock = 100 * 10**9
        assert not await second.mover.move_all()
        assert not await second.mover.move_all()
        owner = await Owner(first, 3).serve()
        await owner.put(30)
        everything = Query(interval=Interval(Bound(None, 0), Bound(None, 40)))
        assert await owner.times(everything) == [10, 11, 12, 20, 21, 30]
        times, dropped = await owner.subscribed(Bound(None, 0))
        assert (sorted(times), dropped) == ([10, 11, 12, 20, 21, 30], 0)
        assert owner.hosted.channel.next_seq == start_of(3) + 1


@pytest.mark.usefixtures("no_pauses_after_failures")
@pytest.mark.asyncio
async def test_an_owner_that_follows_a_lost_one_says_collected_for_items_that_the_limits_have_removed(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    await serve_one_item(tmp_path / "a", store, 1, 10)
    store.delete([name for name in store.objects if name.endswith(".stopped")])
    async with host(tmp_path / "b", store) as second:
        second.clock = 200 * 10**9
        owner = await Owner(second, 2).serve(max_items=1)
        await owner.put(200 * 10**9)
        assert not await second.mover.move_all()
        found = owner.recording.recorder.files
        assert [one.begin for one in found.drop_outdated(ArchiveLimits(10**9, None), second.clock)] == [start_of(2)]
        owner.recording.recorder.keep(found.segments)
        answer = await owner.read(Query(interval=Interval(Bound(None, 10), Bound(None, 10))))
        assert answer.reason == "COLLECTED"


@pytest.mark.asyncio
async def test_before_its_first_write_a_new_owner_knows_that_a_file_of_the_former_one_is_missing(
    tmp_path: Path,
) -> None:
    """In an earlier version, reads gave no reason for its items if the file did not come."""
    store = FakeStore()
    async with host(tmp_path / "a", store) as former, host(tmp_path / "b", store) as new:
        await former.serve(1)
        await former.write()
        await former.mover.move_all()
        await former.write(2)  # this file is on the disk of the former owner when the channel moves
        await take_over(new, 4, [3])
        assert [one.end_seq for one in new.recorder.segments] == [2]
        assert [one.end_seq for one in new.recorder.readable_segments] == [3]


@pytest.mark.asyncio
async def test_before_its_first_write_a_host_to_which_a_channel_moves_back_knows_that_it_lacks_items(
    tmp_path: Path,
) -> None:
    """The items of the time at the other host that have left memory. In an earlier version, reads gave no reason."""
    async with host(tmp_path / "a", None) as one:
        await one.serve(1)
        await one.write(2)
        one.archive.forget(one.recorder)
        await take_over(one, 6, [4, 5])
        assert [one.end_seq for one in one.recorder.segments] == [3]
        assert [one.end_seq for one in one.recorder.readable_segments] == [4]
        await one.archive.write_all()


@pytest.mark.asyncio
async def test_a_channel_that_moves_to_the_folder_of_a_lost_owner_has_no_seq_twice(tmp_path: Path) -> None:
    """In an earlier version, the next owner of a folder began with the seq 1. After a move to the folder of the lost
    owner, a reader that continued after an item of the next owner got items of the lost one.
    """
    await lost(tmp_path / "a", None, 1, 10, 11, 12)
    async with host(tmp_path / "a", None) as first, host(tmp_path / "b", None) as second:
        owner = await Owner(second, 2).serve()
        await owner.put(20, 21, 22, 23, 24)
        begin, end = start_of(2), owner.hosted.channel.next_seq
        assert end == begin + 5
        moved = await take_over(first, end, [begin + 3, begin + 4])
        moved.changed(1)
        await first.archive.write_all()
        assert first.read() == [1, 2, 3, begin + 3, begin + 4]
        assert [given_over(one.first_seq, one.end_seq, [4]) for one in first.recorder.segments] == [3, 5]
        assert first.recorder.unarchived == 3
