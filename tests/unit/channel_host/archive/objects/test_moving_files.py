"""Segments that move to an object store: crashes between the steps, several hosts, and damaged and foreign objects."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from stampede_rt_channel_host.archive.objects import stored_segments
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore, StoreError
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits
from stampede_rt_channel_host.core.archive import ROW_BYTES, ArchivedRun, Hole, Segment
from tests.support.channel_host.object_stores import PREFIX, FakeStore, move, moving_files, opened_files
from tests.unit.channel_host.archive.test_archive_files import ALL, decode, seqs, write


def cut(body: bytes, begin: int, end: int) -> bytes:
    return b"%d cut" % (int(body.split(b" ")[0]) + begin)


def found_by(files: MovingFiles) -> list[int]:
    return seqs(files, files.segments)


def host(tmp_path: Path, name: str, store: SegmentStore, epoch: int) -> MovingFiles:
    return opened_files(tmp_path / name, store, epoch, cut)


def write_closed(files: MovingFiles, first: int, blocks: int = 2) -> tuple[Segment, ...]:
    """Write a segment, and close it."""
    segments = write(files, first, blocks)
    files.look(2**62, 0, None)
    return segments


def local(tmp_path: Path, name: str) -> list[str]:
    return sorted(path.name for path in (tmp_path / name / "channels").rglob("*.segment"))


@pytest.mark.asyncio
async def test_a_segment_that_left_the_archive_while_it_moved_does_not_come_back_after_a_crash(tmp_path: Path) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    files.stored.note(1)  # as at each opening
    for first in (1, 5, 9):
        write_closed(files, first)
    packed = files.stored.pack(files.waiting[0])
    await store.create(packed.name, packed.content)
    files.drop_outdated(ArchiveLimits(None, files.segments[-1].length), 0)
    assert found_by(files) == [9, 10, 11, 12]
    reopened = host(tmp_path, "a", store, 2)  # the process was killed and starts again
    assert found_by(reopened) == [9, 10, 11, 12]
    assert reopened.stored.outdated == [packed.name]
    write_closed(reopened, 13)
    assert found_by(host(tmp_path, "a", store, 3)) == [*range(9, 17)]


@pytest.mark.parametrize("steps", range(4))
@pytest.mark.asyncio
async def test_a_host_killed_between_any_two_steps_of_a_move_neither_loses_nor_repeats_items(
    tmp_path: Path, steps: int
) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    write_closed(files, 1)
    write_closed(files, 5)
    await move(files, store, steps=steps)
    assert len(local(tmp_path, "a")) == (0 if steps == 3 else 2)
    files = host(tmp_path, "a", store, 2)  # the process was killed and starts again
    assert found_by(files) == [1, 2, 3, 4, 5, 6, 7, 8]
    write_closed(files, 9)
    await move(files, store)
    assert local(tmp_path, "a") == []
    assert len(store.objects) == 3
    assert found_by(files) == [*range(1, 13)]
    assert found_by(host(tmp_path, "b", store, 3)) == [*range(1, 13)]


@pytest.mark.asyncio
async def test_the_next_owner_reads_the_moved_files_and_the_former_owner_cannot_change_them(tmp_path: Path) -> None:
    store = FakeStore()
    former = host(tmp_path, "a", store, 1)
    write_closed(former, 1)
    await move(former, store)
    write_closed(former, 5)  # the host loses its lease before it moves this file
    owner = host(tmp_path, "b", store, 2)
    assert found_by(owner) == [1, 2, 3, 4]
    write_closed(owner, 5, 1)
    await move(owner, store)
    before = dict(store.objects)
    await move(former, store)  # the former owner goes on moving files, because it does not know of the new owner
    assert {name: store.objects[name] for name in before} == before
    assert found_by(owner) == [1, 2, 3, 4, 5, 6]
    assert found_by(host(tmp_path, "c", store, 3)) == [1, 2, 3, 4, 5, 6]
    with pytest.raises(StoreError, match="later owner"):
        host(tmp_path, "a", store, 1)


@pytest.mark.asyncio
async def test_the_new_host_of_a_moved_channel_takes_over_the_last_files_of_the_former_host(tmp_path: Path) -> None:
    store = FakeStore()
    former = host(tmp_path, "a", store, 1)
    write_closed(former, 1)
    await move(former, store)
    write(former, 5, 3)
    new = host(tmp_path, "b", store, 2)
    # the archive of the new host begins in the middle of a run
    new.write([[ArchivedRun(9, decode(cut(b"7", 1, 2)))]], ArchiveLimits(None, None))
    assert found_by(new) == [1, 2, 3, 4, 8, 9]
    assert new.lacks_items(10)
    window = new.load(new.segments, ALL, decode, lambda: None)
    assert window.holes == [Hole(5, 7, 3)]
    former.close(None)
    await move(former, store)
    assert seqs(new, new.find_again(new.stored.find(2), 10)) == [1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert not new.lacks_items(10)
    new.close(None)
    await move(new, store)
    assert found_by(host(tmp_path, "c", store, 3)) == [1, 2, 3, 4, 5, 6, 7, 8, 9]


@pytest.mark.asyncio
async def test_the_new_host_of_an_idle_channel_takes_over_the_last_files_but_not_the_lost_items_in_them(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    former = host(tmp_path, "a", store, 1)
    write_closed(former, 1)
    await move(former, store)
    write_closed(former, 5)
    write_closed(former, 9)  # the new owner does not know of these items
    new = host(tmp_path, "b", store, 2)
    assert new.lacks_items(9)
    await move(former, store)
    assert seqs(new, new.find_again(new.stored.find(2), 9)) == [1, 2, 3, 4, 5, 6, 7, 8]
    assert not new.lacks_items(9)
    assert len(store.objects) == 3
    write_closed(new, 9)
    assert found_by(new) == [*range(1, 13)]


@pytest.mark.asyncio
async def test_limits_remove_only_objects_of_the_channel(tmp_path: Path) -> None:
    store = FakeStore()
    foreign = {PREFIX + "notes.txt": b"mine", "channels/ff/1.segment": b"x", "other": b"y", PREFIX + "a/b": b"z"}
    store.objects.update(foreign)
    files = host(tmp_path, "a", store, 1)
    for first in (1, 5, 9):
        write_closed(files, first)
    await move(files, store)
    files.look(10**18, 10**18, ArchiveLimits(10, None))
    assert len(files.stored.outdated) == 2
    assert found_by(files) == [9, 10, 11, 12]
    reopened = files.find_again(files.stored.find(1), 13)  # the objects are still there
    assert seqs(files, reopened) == [9, 10, 11, 12]
    store.delete(files.stored.outdated)
    assert len(store.objects) == len(foreign) + 1
    assert {name: store.objects[name] for name in foreign} == foreign


@pytest.mark.asyncio
async def test_the_list_of_objects_on_the_disk_does_not_grow_with_the_objects_that_have_left_the_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stored_segments, "CHANGES_LEAST", 5)
    store = FakeStore()
    files = moving_files(tmp_path / "a", store, cut)
    files.open_found(1, 0, {})
    for first in range(1, 80, 4):
        write_closed(files, first)
        await move(files, store)
        files.look(10**18, 10**18, ArchiveLimits(10, None))
    [lines] = [path.read_text().splitlines() for path in (tmp_path / "a").rglob("objects")]
    assert len(lines) < 10
    known = files.known(1, 0)
    assert known is not None
    assert [one.name for one in known.values()] == [*store.objects.keys() - {*files.stored.outdated}]


@pytest.mark.asyncio
async def test_a_flipped_bit_in_a_block_loses_this_block_and_one_in_the_index_loses_nothing(tmp_path: Path) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    segments = write_closed(files, 1, 3)
    await move(files, store)
    [(name, good)] = store.objects.items()
    for at, expected in ((good.index(b"3 "), [1, 2, 5, 6]), (segments[0].length + 3, [1, 2, 3, 4, 5, 6])):
        store.objects[name] = good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :]
        other = host(tmp_path, "b", store, 2)
        assert found_by(other) == expected
        assert other.damaged_blocks == (1 if len(expected) == 4 else 0)


@pytest.mark.asyncio
async def test_an_object_stays_in_the_store_if_all_its_blocks_before_the_next_owner_are_damaged(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    segments = write_closed(files, 1, 3)
    await move(files, store)
    [name] = store.objects
    later = host(tmp_path, "b", store, 2)
    write_closed(later, 3, 2)  # the same seqs again, after the first block
    await move(later, store)
    damaged = bytearray(store.objects[name])
    damaged[damaged.index(b"1 ") - ROW_BYTES - 20] ^= 1  # in the head of the first block
    damaged[segments[0].length + 3] ^= 1  # in the index
    store.objects[name] = bytes(damaged)
    next_owner = host(tmp_path, "c", store, 3)
    assert found_by(next_owner) == [3, 4, 5, 6]
    assert name not in next_owner.stored.outdated
    assert store.objects[name] == damaged


@pytest.mark.asyncio
async def test_the_host_reads_all_complete_blocks_of_an_object_that_is_cut_at_any_byte(tmp_path: Path) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    write_closed(files, 1, 3)
    await move(files, store)
    [(name, good)] = store.objects.items()
    for size in range(0, len(good), 29):
        store.objects[name] = good[:size]
        found = found_by(host(tmp_path, "b", store, 2))
        assert found == list(range(1, len(found) + 1))


@pytest.mark.asyncio
async def test_a_host_notices_damage_in_its_cache_on_disk_and_reads_the_object_again(tmp_path: Path) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    write_closed(files, 1, 3)
    await move(files, store)
    other = host(tmp_path, "b", store, 2)
    assert found_by(other) == [1, 2, 3, 4, 5, 6]
    for path in (tmp_path / "b" / "cache").iterdir():
        path.write_bytes(bytes(path.stat().st_size))
    assert found_by(other) == [1, 2, 3, 4, 5, 6]
    assert other.damaged_blocks == 0


@pytest.mark.asyncio
async def test_a_host_neither_overwrites_nor_reads_an_object_of_the_same_name_with_other_bytes(tmp_path: Path) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    write_closed(files, 1)
    packed = files.stored.pack(files.waiting[0])
    store.objects[packed.name] = b"something else"
    with pytest.raises(FileExistsError, match="does not have the object"):
        await move(files, store)
    assert store.objects == {packed.name: b"something else"}
    assert found_by(host(tmp_path, "a", store, 2)) == [1, 2, 3, 4]  # the host reads the file, not the object


@pytest.mark.asyncio
async def test_an_archive_of_10_000_objects_opens_with_one_listing(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    files = host(tmp_path, "a", store, 1)
    write_closed(files, 1, 1)
    await move(files, store)
    [(name, content)] = store.objects.items()
    fields = name.removeprefix(PREFIX).split("_")
    for number in range(2, 10_001):
        seq = 2 * number - 1
        fields[0], fields[3:] = (
            f"{10**9 + number:018}",
            [str(seq), str(seq + 2), f"{seq}.{seq}", f"{seq + 1}.{seq + 1}"],
        )
        store.objects[f"{PREFIX}{'_'.join(fields)}_0.segment"] = content
    store.calls.clear()
    other = host(tmp_path, "b", store, 2)
    segments = other.segments
    assert len(segments) == 10_000
    assert segments[-1].end_seq == 20_001
    assert store.calls == [f"find {PREFIX}"]


def test_opening_a_channel_fails_with_a_reason_while_the_object_store_is_unreachable(tmp_path: Path) -> None:
    store = FakeStore()
    store.failure = "the network is down"
    with pytest.raises(StoreError, match="network is down"):
        host(tmp_path, "a", store, 1)
    assert moving_files(tmp_path / "a", store).waiting == ()


@pytest.mark.asyncio
async def test_objects_that_leave_the_archive_together_take_one_write_of_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, synced = FakeStore(), list[int]()
    files = host(tmp_path, "a", store, 1)
    files.stored.note(1)
    for number in range(6):
        write_closed(files, 1 + 4 * number)
    await move(files, store)
    fsync = os.fsync
    monkeypatch.setattr("os.fsync", lambda file: (synced.append(file), fsync(file)))
    assert len(files.drop_outdated(ArchiveLimits(1, None), 2**62)) == 1
    assert len(files.stored.outdated) == 5
    assert len(synced) == 1
    known = files.known(1, 0)
    assert known is not None
    assert [*known] == [one.number for one in files.segments]


@pytest.mark.asyncio
async def test_no_item_is_lost_if_the_store_fails_while_a_host_takes_over_the_last_files(tmp_path: Path) -> None:
    store = FakeStore()
    former = host(tmp_path, "a", store, 1)
    write_closed(former, 1)
    await move(former, store)
    write_closed(former, 5)
    await move(former, store, steps=0)
    new = host(tmp_path, "b", store, 2)
    write(new, 7, 2)  # the new owner has a part of the former owner's last file, too
    await move(former, store)
    found = new.stored.find(2)
    store.failure = "the network is down"
    with pytest.raises(StoreError, match="network is down"):
        new.find_again(found, 11)
    store.failure = ""
    assert seqs(new, new.find_again(new.stored.find(2), 11)) == [*range(1, 11)]
    assert not new.lacks_items(11)


@pytest.mark.asyncio
async def test_a_new_owner_misses_the_last_file_of_a_former_owner_whose_earlier_files_have_come(tmp_path: Path) -> None:
    store = FakeStore()
    former = host(tmp_path, "a", store, 1)
    for first in (1, 5):
        write_closed(former, first)
    await move(former, store)
    owner = host(tmp_path, "b", store, 1)  # opened before the move is committed
    owner.raise_epoch(2)
    assert (owner.lacks_former(9), owner.lacks_former(10)) == (False, True)
