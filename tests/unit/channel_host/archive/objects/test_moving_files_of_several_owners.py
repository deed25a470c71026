"""Segments of several owners of one channel, which have some items twice."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt.values.seq_starts import start_of
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from stampede_rt_channel_host.archive.written_parts import Advances, MissingSeqs
from stampede_rt_channel_host.core.archive import ArchivedAdvance, ArchivedRun
from tests.support.channel_host.object_stores import FakeStore, move, moving_files, opened_files
from tests.unit.channel_host.archive.test_archive_files import ALL, NO_LIMITS, decode, run_at, seqs, write

ITEMS = [*range(1, 9)]


def cut(body: bytes, begin: int, end: int) -> bytes:
    return b"%d cut" % (int(body.split(b" ")[0]) + begin)


async def moved_back(tmp_path: Path, store: FakeStore, first_seq: int) -> tuple[MovingFiles, MovingFiles]:
    """The files of a host to which a channel has moved back, and those of the host that it has left.

    The second host has items from `first_seq` on, and has not moved its file to the store yet.
    """
    first = opened_files(tmp_path / "a", store, 1, cut)
    write(first, 1, 4)
    first.close(None)
    await move(first, store)
    second = opened_files(tmp_path / "b", store, 2, cut)
    if first_seq % 2:
        write(second, first_seq, (9 - first_seq) // 2)
    else:
        second.write([[ArchivedRun(9, decode(cut(b"%d" % (first_seq - 1), 1, 2)))]], ArchiveLimits(None, None))
    second.close(None)
    return opened_files(tmp_path / "a", store, 3, cut), second


@pytest.mark.asyncio
@pytest.mark.parametrize("first_seq", [8, 7, 5])
async def test_a_read_before_the_file_of_the_former_owner_came_does_not_double_its_items(
    tmp_path: Path, first_seq: int
) -> None:
    """In an earlier version, the host kept the places of the blocks that it had found, with all their items."""
    store = FakeStore()
    files, second = await moved_back(tmp_path, store, first_seq)
    before = files.segments
    assert seqs(files, before) == ITEMS
    await move(second, store)
    after = files.find_again(files.stored.find(3), 9)
    assert seqs(files, after) == ITEMS
    assert seqs(files, before) == ITEMS, "a read that began before the file came has each item once"
    assert seqs(files, after) == ITEMS
    window = files.load(after, ALL, decode, lambda: None)
    assert window.holes == []


@pytest.mark.asyncio
async def test_a_file_moves_to_the_store_although_a_later_file_of_another_owner_is_there(tmp_path: Path) -> None:
    """In an earlier version, it stayed in the folder until the next start, and a clean stop did not count it."""
    store = FakeStore()
    first = opened_files(tmp_path / "a", store, 1, cut)
    write(first, 1, 2)
    first.close(None)
    second = opened_files(tmp_path / "b", store, 2, cut)
    write(second, 5, 2)
    second.close(None)
    await move(second, store)
    returned = opened_files(tmp_path / "a", store, 3, cut)  # the channel moves back before the first file has moved
    write(returned, 9, 1)
    assert returned.local_bytes() == returned.segments[0].length + returned.segments[2].length
    returned.close(CleanStop(1, None))
    assert returned.name_of_stop() is None, "the store does not have all segments"
    await move(returned, store)
    assert returned.local_bytes() == 0
    assert returned.name_of_stop() is not None
    last = opened_files(tmp_path / "c", store, 4, cut)
    assert seqs(last, last.segments) == [*ITEMS, 9, 10]


@pytest.mark.asyncio
async def test_a_segment_leaves_the_list_before_its_object_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, a read between both steps took the removed segment for a damaged one."""
    store = FakeStore()
    files, second = await moved_back(tmp_path, store, 1)
    (repeated,) = files.segments
    await move(second, store)
    listed: list[bool] = []
    remove = files.stored.remove
    monkeypatch.setattr(files.stored, "remove", lambda number: (listed.append(files.has(number)), remove(number)))
    assert seqs(files, files.find_again(files.stored.find(3), 9)) == ITEMS
    assert listed == [False]
    with pytest.raises(FileNotFoundError):  # the caller reads the present segments then
        files.load((repeated,), ALL, decode, lambda: None)


@pytest.mark.asyncio
@pytest.mark.parametrize("is_stored", [True, False])
async def test_an_owner_that_has_only_the_note_of_a_loss_left_hides_no_items_of_former_owners(
    tmp_path: Path, is_stored: bool
) -> None:
    """In an earlier version, it hid all items that it had not found in the store when it began: reads said LOST for
    them, and the host deleted their objects.
    """
    store, begin = FakeStore(), start_of(2)
    first = opened_files(tmp_path / "a", store, 1, cut)
    write(first, 1, 4)
    first.close(None)
    second = opened_files(
        tmp_path / "b", store, 2, cut
    )  # the first owner is lost, and its file is not in the store yet
    second.write([MissingSeqs(1, 1, 20), [ArchivedRun(21, run_at(begin))]], ArchiveLimits(None, None))
    second.close(None)
    third = opened_files(tmp_path / "c", store, 3, cut)  # the channel has moved, and its items came along
    write(third, begin, 2)
    third.close(None)
    for one in (first, third, *([second] if is_stored else [])):
        await move(one, store)
    last = opened_files(tmp_path / "b", store, 4, cut)
    assert seqs(last, last.segments) == [*ITEMS, *range(begin, begin + 4)]
    assert [one.begin for one in last.segments] == [1, begin, begin]
    found = last.find_again(last.stored.find(4), begin + 4)
    assert seqs(last, found) == [*ITEMS, *range(begin, begin + 4)]
    assert len(store.objects) == (3 if is_stored else 2)
    window = last.load(found, ALL, decode, lambda: None)
    assert [one.end for one in window.holes] == [19], "the loss is still known"


@pytest.mark.asyncio
async def test_a_host_opens_overlapping_objects_of_its_own_list_while_the_store_is_unreachable(tmp_path: Path) -> None:
    """In an earlier version, it could serve the channel only when the store was back."""
    store = FakeStore()
    files, second = await moved_back(tmp_path, store, 5)
    await move(second, store)
    files.find_again(files.stored.find(3), 9)
    files.stored.note(3)
    write(files, 9, 1)
    files.close(None)
    store.failure = "unreachable"
    restarted = moving_files(tmp_path / "a", store, cut)
    restarted.is_listed = False
    known = restarted.known(3, 1)
    assert known is not None
    opened = restarted.open_found(3, 1, known)
    assert [(one.first_seq, one.end_seq) for one in opened.segments] == [(1, 5), (5, 9), (9, 11)]
    with pytest.raises(OSError, match="unreachable"):
        seqs(restarted, restarted.segments)
    store.failure = ""
    assert seqs(restarted, restarted.segments) == [*ITEMS, 9, 10]
    assert restarted.segments[0].high == (8, 8), "the bounds are those of the whole object"
    found = restarted.find_again(restarted.stored.find(3), 11)
    assert seqs(restarted, found) == [*ITEMS, 9, 10]
    assert found[:2] == opened_files(tmp_path / "c", store, 4, cut).segments


@pytest.mark.asyncio
async def test_an_owner_whose_items_were_all_written_again_hides_no_repeated_items_while_the_store_is_unreachable(
    tmp_path: Path,
) -> None:
    """In an earlier version, reads had the repeated items of the first owner twice."""
    store = FakeStore()
    first = opened_files(tmp_path / "a", store, 1, cut)
    write(first, 1, 2)
    first.close(None)
    await move(first, store)
    second = opened_files(tmp_path / "b", store, 2, cut)
    second.write([Advances(5, (ArchivedAdvance(1, 1),))], NO_LIMITS)
    write(second, 5, 2)
    second.close(None)
    third = opened_files(tmp_path / "c", store, 3, cut)  # the channel has moved, and its items came along
    write(third, 3, 3)
    third.close(None)
    await move(second, store)
    found = third.find_again(third.stored.find(3), 9)
    third.stored.note(3)
    store.failure = "unreachable"
    restarted = moving_files(tmp_path / "c", store, cut)
    restarted.is_listed = False
    known = restarted.known(3, 1)
    assert known is not None
    opened = restarted.open_found(3, 1, known)
    store.failure = ""
    assert seqs(restarted, opened.segments) == ITEMS
    assert restarted.find_again(restarted.stored.find(3), 9) == found
