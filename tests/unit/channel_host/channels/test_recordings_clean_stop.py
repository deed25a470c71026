"""A host takes a recorded channel over, and learns from the object store that the former host stopped cleanly."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stampede_rt.values.seq_starts import start_of
from stampede_rt.values.timeline import NOW, OLDEST, Bound, Interval
from stampede_rt_channel_host.archive.clean_stop import CleanStop, name_of_stop, stop_named
from stampede_rt_channel_host.archive.objects.opened_store import OpenedStore
from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, LaterOwner, SegmentStore, StoreError
from stampede_rt_channel_host.core.channel import Query
from tests.support.channel_host.object_stores import CHANNEL, PREFIX, FakeStore, moving_files
from tests.support.channel_host.recorded_hosts import Host, Owner, no_pauses_after_failures  # noqa: F401

ALL = Query(interval=Interval(OLDEST, NOW))
SINCE = 1000
"""The instant of the first take-over."""


pytestmark = pytest.mark.usefixtures("no_pauses_after_failures")


def all_up_to(time: int) -> Query:
    return Query(interval=Interval(Bound(None, 0), Bound(None, time)))


def stops(store: FakeStore) -> list[str]:
    return [name for name in store.objects if name.endswith(".stopped")]


async def owner(path: Path, store: SegmentStore, epoch: int, **policy: int) -> Owner:
    """The owner of the channel in this epoch. Call `stop` or `kill`."""
    one = Host(path, store)
    one.clock = (epoch - 1) * SINCE
    return await Owner(one, epoch).serve(**policy)


async def stop(one: Owner) -> None:
    await one.recordings.close(1)


def kill(one: Owner) -> None:
    one.recording.recorder.files._end_segment()
    one.host.archive.folder.close()


def in_memory(path: Path) -> SegmentStore:
    return FakeStore()


def in_a_folder(path: Path) -> SegmentStore:
    return OpenedStore(f"file://{path}/store")


@pytest.mark.parametrize("store_at", [in_memory, in_a_folder])
@pytest.mark.asyncio
async def test_after_a_clean_stop_the_next_owner_has_all_items_and_says_that_none_are_lost(
    tmp_path: Path, store_at: Callable[[Path], SegmentStore]
) -> None:
    store = store_at(tmp_path)
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1, 2, 3)
    await stop(first)
    second = await owner(tmp_path / "b", store, 2)
    assert second.hosted.channel.next_seq == 4
    assert (await second.read(all_up_to(3))).reason is None
    await second.put(SINCE + 1)
    answer = await second.read(ALL)
    assert (answer.reason, answer.truncated) == (None, False)
    assert await second.times(ALL) == [1, 2, 3, SINCE + 1]
    await stop(second)
    third = await owner(tmp_path / "c", store, 3)
    await third.put(2 * SINCE + 1)
    answer = await third.read(ALL)
    assert (answer.reason, await third.times(ALL)) == (None, [1, 2, 3, SINCE + 1, 2 * SINCE + 1])
    await stop(third)


@pytest.mark.asyncio
async def test_only_the_stop_of_the_last_owner_counts_and_the_next_owner_deletes_it(tmp_path: Path) -> None:
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1)
    await stop(first)
    saved = {name: store.objects[name] for name in stops(store)}
    assert len(saved) == 1
    second = await owner(tmp_path / "b", store, 2)
    await second.put(SINCE + 1)
    await second.find()
    assert not stops(store)
    kill(second)
    store.objects.update(saved)  # as if the second owner had been killed before it deleted the object
    third = await owner(tmp_path / "c", store, 3)
    await third.put(2 * SINCE + 1)
    assert (await third.read(ALL)).reason == "LOST"
    await stop(third)


@pytest.mark.asyncio
async def test_after_a_stop_with_an_unreachable_store_the_next_owner_says_that_items_are_lost(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1)
    store.failure = "unreachable"
    await stop(first)
    store.failure = ""
    assert not store.objects
    second = await owner(tmp_path / "b", store, 2)
    await second.put(SINCE + 1)
    assert (await second.read(all_up_to(SINCE + 1))).reason == "LOST"
    await stop(second)


@pytest.mark.parametrize("times", [(), (1, 2)])
@pytest.mark.asyncio
async def test_an_owner_that_could_not_reach_the_store_at_first_learns_of_the_clean_stop_later(
    tmp_path: Path, times: tuple[int, ...]
) -> None:
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(*times)
    await stop(first)
    store.failure = "unreachable"
    second = await owner(tmp_path / "b", store, 2)
    await second.put(SINCE + 1)
    store.failure = ""
    await second.find()
    answer = await second.read(all_up_to(SINCE + 1))
    assert (answer.reason, await second.times(ALL)) == (None, [*times, SINCE + 1])
    await stop(second)
    third = await owner(tmp_path / "c", store, 3)
    # an archive that begins with the second owner does not prove that there were no earlier items (decision 0290)
    assert (await third.read(all_up_to(SINCE + 1))).reason == (None if times else "COLLECTED")
    await stop(third)


@pytest.mark.asyncio
async def test_an_owner_that_learns_of_the_stop_later_says_lost_if_an_object_is_missing(tmp_path: Path) -> None:
    """An earlier version believed the note of the stop, although the objects that the note names were missing."""
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1, 2)
    await stop(first)
    for name in [one for one in store.objects if one.endswith(".segment")]:
        del store.objects[name]
    store.failure = "unreachable"
    second = await owner(tmp_path / "b", store, 2)
    await second.put(SINCE + 1)
    store.failure = ""
    await second.find()
    assert (await second.read(all_up_to(2))).reason == "LOST"
    await stop(second)


@pytest.mark.parametrize("is_unreachable", [False, True])
@pytest.mark.asyncio
async def test_after_an_item_in_the_future_the_next_owner_says_lost_from_the_last_acceptance_on(
    tmp_path: Path, is_unreachable: bool
) -> None:
    """An earlier version said LOST only for reads beyond the time of that item."""
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1, max_future_nanos=10**6)
    await first.put(1, 2)
    await first.put(500_000, at=3)
    first.host.clock += 61 * 10**9
    await first.find()
    kill(first)
    store.failure = "unreachable" if is_unreachable else ""
    second = await owner(tmp_path / "b", store, 2)
    store.failure = ""
    await second.find()
    assert (await second.read(Query(interval=Interval(Bound(None, 4), Bound(None, 5))))).reason == "LOST"
    assert (await second.read(Query(interval=Interval(Bound(None, 0), Bound(None, 1))))).reason is None
    await stop(second)


async def idle_run(path: Path, store: FakeStore, epoch: int, *, is_clean: bool = True) -> None:
    """Run a process of the host that owns the channel in this epoch. No client uses the channel meanwhile."""
    one = Host(path, store)
    one.mover.own({CHANNEL: epoch})
    if is_clean:
        await one.archive.close([])
    else:
        one.archive.folder.close()


@pytest.mark.parametrize(("runs", "reason"), [([True], None), ([True, True], None), ([True, False, True], "LOST")])
@pytest.mark.asyncio
async def test_a_channel_that_nobody_used_since_the_start_of_its_host_is_known_as_cleanly_stopped(
    tmp_path: Path, runs: list[bool], reason: str | None
) -> None:
    """`runs`: whether each later process of the host stops cleanly."""
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1, 2)
    await stop(first)
    for epoch, is_clean in enumerate(runs, 2):
        await idle_run(tmp_path / "a", store, epoch, is_clean=is_clean)
    second = await owner(tmp_path / "b", store, 2 + len(runs))
    assert second.hosted.channel.next_seq == (3 if reason is None else start_of(2 + len(runs)))
    await second.put(9 * SINCE)
    assert (await second.read(ALL)).reason == reason
    await second.find()
    assert not stops(store)
    await stop(second)


@pytest.mark.asyncio
async def test_a_start_without_callers_moves_the_last_files_and_the_clean_stop_to_the_store(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1, 2)
    store.failure = "unreachable"
    await stop(first)
    store.failure = ""
    await idle_run(tmp_path / "a", store, 2)
    second = await owner(tmp_path / "b", store, 3)
    assert await second.times(ALL) == [1, 2]
    assert (await second.read(all_up_to(3 * SINCE))).reason is None
    await stop(second)


@pytest.mark.asyncio
async def test_a_clean_stop_does_not_hide_an_earlier_loss(tmp_path: Path) -> None:
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1)
    await first.host.archive.write_all()
    first.host.clock += 61 * 10**9
    await first.find()
    kill(first)
    second = await owner(tmp_path / "b", store, 2)
    await second.put(SINCE + 1)
    await stop(second)
    third = await owner(tmp_path / "c", store, 3)
    assert (await third.read(all_up_to(SINCE + 1))).reason == "LOST"
    later = Query(interval=Interval(Bound(None, SINCE + 1), Bound(None, SINCE + 1)))
    assert (await third.read(later)).reason is None
    assert (await third.read(Query(interval=Interval(Bound(None, 0), Bound(None, 0))))).reason != "LOST"
    await stop(third)


def test_a_host_that_lost_its_lease_opens_no_channel_with_a_clean_stop_of_a_later_owner(tmp_path: Path) -> None:
    store = FakeStore()
    files = moving_files(tmp_path, store)
    store.objects[PREFIX + name_of_stop(CleanStop(0, epoch=3))] = b""
    with pytest.raises(LaterOwner, match="later owner"):
        files.stored.find(2)


@pytest.mark.parametrize(
    "stop", [CleanStop(0, epoch=1), CleanStop(0, None, -5, 7, b"", 12, 2**63, -9), CleanStop(0, None, None, 7, b"", 3)]
)
def test_the_name_of_the_object_tells_all_about_a_clean_stop(stop: CleanStop) -> None:
    assert stop_named(name_of_stop(stop)) == stop


@pytest.mark.parametrize("name", ["", "x", "1_2_x_x_x.stopped", "000000001_2_x_x.stopped", "000000001_2_x_x_x.segment"])
def test_an_object_with_another_name_says_nothing_about_the_stop(name: str) -> None:
    assert stop_named(name) is None


@pytest.mark.asyncio
async def test_a_listing_that_began_before_the_last_segment_was_made_is_repeated(tmp_path: Path) -> None:
    class LateListing(FakeStore):
        """A store whose first listing has the clean stop, but not the segment that the owner made before it."""

        hides = False

        def find(self, prefix: str) -> Iterator[FoundObject]:
            hides, self.hides = self.hides, False
            yield from (one for one in super().find(prefix) if not (hides and one.name.endswith(".segment")))

    store = LateListing()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1, 2, 3)
    await stop(first)
    store.hides = True
    second = await owner(tmp_path / "b", store, 2)
    assert (await second.read(all_up_to(3))).reason is None
    assert await second.times(ALL) == [1, 2, 3]
    await stop(second)


@pytest.mark.asyncio
async def test_a_host_that_cannot_tell_the_next_owner_about_its_stop_logs_why(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class SegmentsOnlyStore(FakeStore):
        """A store that takes segments only."""

        async def create(self, name: str, content: bytes | bytearray) -> bool:
            if name.endswith(".stopped"):
                raise StoreError("the store refuses this name")
            return await super().create(name, content)

    one = await owner(tmp_path / "a", SegmentsOnlyStore(), 1)
    await one.put(1)
    await stop(one)
    whys = [vars(line).get("why") for line in caplog.records if vars(line).get("event") == "archive_store_failed"]
    assert whys == ["the store refuses this name"]
