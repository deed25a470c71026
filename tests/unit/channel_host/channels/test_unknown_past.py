"""A host that takes a recorded channel over while the object store of its archive is unreachable."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.values.seq_starts import start_of
from stampede_rt.values.timeline import NEWEST, NOW, OLDEST, Bound, Interval, Match
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.recordings import Recordings
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMoves
from stampede_rt_channel_host.core.channel import Offer, Query
from stampede_rt_channel_host.core.group import Horizon
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.recorded_hosts import Host, Owner, host, no_pauses_after_failures, record  # noqa: F401

ALL = Query(interval=Interval(OLDEST, NOW))
LATEST = Query(interval=Interval(Bound(None, 0), NOW), limit=1, newest_first=True)
SINCE = 1000
"""The instant of the take-over."""
pytestmark = pytest.mark.usefixtures("no_pauses_after_failures")


async def serve_until_lost(path: Path, store: FakeStore) -> None:
    """Serve the channel, move the items at 1, 2 and 3 to the store, and lose the host with the item at 4."""
    former = Host(path, store)
    await former.serve(1)
    for _ in range(3):
        await former.write()
        assert not await former.mover.move_all()
    await former.write()
    former.archive.folder.close()


async def take_channel_over(path: Path, store: FakeStore) -> Owner:
    """Start a host that takes the channel over. The caller stops or kills the host."""
    one = Host(path, store)
    one.clock = SINCE
    return await Owner(one).serve()


@pytest.mark.asyncio
async def test_the_new_owner_serves_its_items_and_refuses_reads_of_a_past_that_it_does_not_know(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "connection refused"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve()
        assert owner.hosted.channel.next_seq == start_of(2)
        with pytest.raises(Unavailable, match="was unreachable"):
            await owner.read(LATEST)
        await owner.put(SINCE + 1, SINCE + 2)
        later = Bound(None, SINCE + 1)
        assert await owner.times(LATEST) == [SINCE + 2]
        assert await owner.times(Query(interval=Interval(later, NOW))) == [SINCE + 1, SINCE + 2]
        assert await owner.subscribed(later) == ([SINCE + 1, SINCE + 2], 0)
        for start in (OLDEST, Bound(None, 3), Bound(None, SINCE)):
            with pytest.raises(Unavailable, match='within="memory"'):
                await owner.read(Query(interval=Interval(start, NEWEST)))
        with pytest.raises(Unavailable):
            await owner.subscribed(OLDEST)
        with pytest.raises(Unavailable):
            owner.recording.past_reader()
        assert await owner.times(Query(interval=Interval(Bound(None, SINCE), NOW), match=Match.START))


@pytest.mark.asyncio
async def test_a_read_waits_for_the_store_while_items_of_the_former_owner_may_overlap(tmp_path: Path) -> None:
    store = FakeStore()
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve(overlap_nanos=100)
        await owner.put(SINCE + 1, SINCE + 200)
        for time, hidden in ((SINCE + 99, True), (SINCE + 100, False)):
            query = Query(interval=Interval(Bound(None, time), Bound(None, time)))
            assert owner.recording.reaches(query, owner.now()) == hidden
            started = Query(interval=query.interval, match=Match.START)
            assert not owner.recording.reaches(started, owner.now())


@pytest.mark.asyncio
async def test_a_read_through_a_group_waits_for_the_store_if_it_needs_it(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve()
        await owner.put(SINCE + 1, SINCE + 2)
        horizon = Horizon(SINCE + 2, lambda: "")
        early, late = ALL, Query(interval=Interval(Bound(None, SINCE + 1), NOW))
        assert owner.recording.reaches_in_group(early, horizon, owner.now())
        with pytest.raises(Unavailable, match="was unreachable"):
            await owner.recording.read_in_group(early, horizon, None, PieceScheduler(), owner.now, waits=False)
        assert not owner.recording.reaches_in_group(late, horizon, owner.now())


@pytest.mark.asyncio
async def test_reads_and_subscriptions_have_all_items_and_no_false_gap_with_a_reachable_store(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    before = dict(store.objects)
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve()
        await owner.put(SINCE + 1, SINCE + 2)
        store.failure = ""
        await owner.find()
        whole = [1, 2, 3, SINCE + 1, SINCE + 2]
        assert await owner.times(ALL) == whole
        assert (await owner.read(ALL)).reason == "LOST"  # the item at 4
        assert (await owner.read(Query(interval=Interval(Bound(None, 0), Bound(None, 2))))).reason is None
        assert await owner.subscribed(OLDEST) == (whole, 0)
        await owner.put(SINCE + 3)
        assert await owner.times(ALL) == [*whole, SINCE + 3]
        one.clock += 61 * 10**9
        await owner.find()
        assert one.local() == []
        assert await owner.times(ALL) == [*whole, SINCE + 3]
    assert {name: store.objects[name] for name in before} == before


@pytest.mark.asyncio
async def test_an_item_with_an_early_time_is_read_from_the_archive_when_the_store_is_reachable(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve()
        await owner.put(2, SINCE + 1)
        store.failure = ""
        await owner.find()
        assert await owner.times(ALL) == [1, 2, 2, 3, SINCE + 1]
        assert [one.first_time for one in owner.hosted.channel.accepted_from(0)] == [SINCE + 1]


@pytest.mark.asyncio
async def test_a_store_without_items_of_the_channel_ends_the_wait_and_the_answers_say_lost(tmp_path: Path) -> None:
    store = FakeStore()
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve()
        await owner.put(SINCE + 1)
        store.failure = ""
        await owner.find()
        answer = await owner.read(Query(interval=Interval(Bound(None, 0), NOW)))
        assert [one.first_time for one in answer.slices] == [SINCE + 1]
        assert answer.reason == "LOST"


@pytest.mark.asyncio
async def test_a_host_that_restarts_while_the_store_is_unreachable_keeps_items_of_both_owners(
    tmp_path: Path,
) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "unreachable"
    owner = await take_channel_over(tmp_path / "b", store)
    await owner.put(SINCE + 1)
    owner.host.recorder.files.close(None)
    owner.host.archive.folder.close()  # the owner's process is killed
    async with host(tmp_path / "b", store) as one:
        one.clock = 2 * SINCE
        owner = await Owner(one, 3).serve()
        assert owner.hosted.channel.next_seq == start_of(3)
        await owner.put(2 * SINCE + 1)
        store.failure = ""
        await owner.find()
        whole = [1, 2, 3, SINCE + 1, 2 * SINCE + 1]
        assert await owner.times(ALL) == whole
        assert await owner.subscribed(OLDEST) == (whole, 0)
    async with host(tmp_path / "b", store) as one:  # the list on its disk names the objects now
        store.failure = "unreachable"
        one.clock = 3 * SINCE
        owner = await Owner(one, 4).serve()
        assert owner.hosted.channel.next_seq == start_of(3) + 1
        store.failure = ""
        await owner.find()
        assert await owner.times(ALL) == whole


@pytest.mark.parametrize("is_restarted", [False, True])
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.asyncio
async def test_each_read_without_the_store_has_all_items_or_says_that_it_does_not_know_them(
    tmp_path: Path, seed: int, is_restarted: bool
) -> None:
    random, store, ahead = Random(seed), FakeStore(), 40
    former = Host(tmp_path / "a", store)
    first = await Owner(former, 1).serve(max_future_nanos=ahead, max_items=4)
    whole = []
    for at in range(1, 6):
        former.clock = at * SINCE // 5 - 1
        whole.append(former.clock + random.randint(-20, ahead))
        first.hosted.core.put(*offer(whole[-1], former.clock))
        first.hosted.changed(former.clock)
    await first.recordings.close(0)
    store.failure = "unreachable"
    one = Host(tmp_path / "b", store)
    one.clock = SINCE
    owner = await Owner(one).serve(max_future_nanos=ahead, max_items=4)
    for _ in range(6):
        one.clock += random.randint(1, 25)
        whole.append(one.clock + random.randint(-10, ahead))
        owner.hosted.core.put(*offer(whole[-1], one.clock))
        owner.hosted.changed(one.clock)
    await one.archive.write_all()
    if is_restarted:
        await owner.recordings.close(0)
        one = Host(tmp_path / "b", store)
        one.clock = 2 * SINCE
        owner = await Owner(one, 3).serve(max_future_nanos=ahead, max_items=4)
    known = 0
    for start in range(SINCE - 60, SINCE + 200, 3):
        for end in (start, start + 30, start + 400):
            interval = Interval(Bound(None, start), Bound(None, end))
            wanted = sorted(time for time in whole if start <= time <= end)
            latest = max((time for time in whole if start <= time <= end), default=None)
            for query, times in (
                (Query(interval=interval, match=Match.START), wanted),
                (Query(interval=interval, match=Match.START, limit=1, newest_first=True), [latest] * bool(wanted)),
            ):
                with suppress(Unavailable):
                    assert await owner.times(query) == times, (query, whole)
                    known += 1
    assert known
    await owner.recordings.close(0)


def offer(time: int, now: int) -> tuple[Offer, int, Any]:
    made = Offer(times=[time], durations=None, lengths=[7])
    return made, now, lambda seq, kept, stamped: b"%d:%d" % (seq, time)


@pytest.mark.asyncio
async def test_after_a_clean_stop_without_the_store_the_host_serves_the_items_on_its_disk(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "unreachable"
    owner = await take_channel_over(tmp_path / "b", store)
    await owner.put(SINCE + 1, SINCE + 2, SINCE + 3)
    await owner.recordings.close(0)
    async with host(tmp_path / "b", store) as one:
        one.clock = 2 * SINCE
        owner = await Owner(one, 3).serve()
        own = Query(interval=Interval(Bound(None, SINCE + 1), NOW))
        assert await owner.times(LATEST) == [SINCE + 3]
        answer = await owner.read(own)
        assert (answer.reason, await owner.times(own)) == (None, [SINCE + 1, SINCE + 2, SINCE + 3])
        assert await owner.subscribed(Bound(None, SINCE + 2)) == ([SINCE + 2, SINCE + 3], 0)
        with pytest.raises(Unavailable):
            await owner.read(ALL)
        await owner.put(2 * SINCE + 1)
        assert await owner.times(own) == [SINCE + 1, SINCE + 2, SINCE + 3, 2 * SINCE + 1]
        assert await owner.times(LATEST) == [2 * SINCE + 1]
        store.failure = ""
        await owner.find()
        whole = [1, 2, 3, SINCE + 1, SINCE + 2, SINCE + 3, 2 * SINCE + 1]
        assert await owner.times(ALL) == whole
        assert await owner.subscribed(OLDEST) == (whole, 0)


@pytest.mark.asyncio
async def test_a_move_waits_for_the_store_because_the_new_owner_must_not_repeat_seqs(tmp_path: Path) -> None:
    store = FakeStore()
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        recordings = Recordings()
        recordings.archive = one.archive
        with pytest.raises(Unavailable, match="cannot be used"):
            await recordings.prepare_move(record(2), 5)


@pytest.mark.asyncio
async def test_the_new_owner_moves_the_channel_only_when_it_knows_the_former_items(tmp_path: Path) -> None:
    """In an earlier version, the third owner had the store, but its memory said that no earlier items existed."""
    store, other = FakeStore(), b"c" * 16
    await serve_until_lost(tmp_path / "a", store)
    store.failure = "unreachable"
    async with host(tmp_path / "b", store) as one:
        one.clock = SINCE
        owner = await Owner(one).serve()
        await owner.put(SINCE + 1)
        nothing: Any = SimpleNamespace(move_key=b"", name="b")
        moves = OutgoingMoves(nothing, nothing, nothing, nothing)
        moves.allowed.allow(owner.hosted.record.channel_id, 2, other)
        with pytest.raises(Unavailable, match="when this host reaches the store"):
            moves.check(owner.hosted, other)
        store.failure = ""
        await owner.find()
        moves.check(owner.hosted, other)
