"""Subscriptions to a recorded channel whose owner was lost: each reader gets one gap at the place of the loss."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt.values.seq_starts import start_of
from stampede_rt.values.timeline import Bound
from stampede_rt_channel_host.core.channel import AllCursor, Gap, SavedCursor, SubscriptionBatch, run_to_end
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.recorded_hosts import Owner, no_pauses_after_failures  # noqa: F401
from tests.unit.channel_host.channels.test_recordings_clean_stop import SINCE, kill, owner, stop

pytestmark = pytest.mark.usefixtures("no_pauses_after_failures")


async def killed(path: Path, store: FakeStore, epoch: int, *times: int) -> None:
    """An owner of the channel that puts items, moves them to the store, and is then lost."""
    one = await owner(path / str(epoch), store, epoch)
    await one.put(*times)
    one.host.clock += 61 * 10**9
    await one.find()
    kill(one)


async def opened(one: Owner, saved: SavedCursor) -> AllCursor:
    where = {"saved": saved}
    lost_at = await one.recording.losses.places(where, one.now())
    return run_to_end(one.hosted.channel.subscribing_all(one.now(), saved=saved, lost_at=lost_at))


async def step(one: Owner, cursor: AllCursor) -> tuple[list[int], Gap | None]:
    """The next item or gap: the time of the item in a list, and the gap."""
    batch = SubscriptionBatch(more=True)
    while batch.is_empty and batch.more:
        found = await one.recording.since(cursor, 1, one.now)
        batch = one.hosted.channel.since(cursor, one.now(), 1) if found is None else found
    return [time for part in batch.slices for time in part.slice.run.times[part.slice.lo : part.slice.hi]], batch.gap


@pytest.mark.parametrize("max_items", [1, 100])
@pytest.mark.asyncio
async def test_a_subscription_gets_a_gap_for_each_loss_after_its_start(tmp_path: Path, max_items: int) -> None:
    store = FakeStore()
    await killed(tmp_path, store, 1, 1, 2)
    await killed(tmp_path, store, 2, SINCE + 1)
    last = await owner(tmp_path / "3", store, 3, max_items=max_items)
    await last.put(2 * SINCE + 1, 2 * SINCE + 2)
    wanted = [1, 2, SINCE + 1, 2 * SINCE + 1, 2 * SINCE + 2]
    for start, seqs in ((1, [2, 3]), (SINCE, [3]), (SINCE + 1, [3]), (2 * SINCE + 1, [])):
        times, dropped = await last.subscribed(Bound(None, start))
        assert (times, dropped) == ([one for one in wanted if one >= start], 0)
        assert [(one.first_seq, one.items, str(one.reason)) for one in last.gaps] == [
            (start_of(epoch), 0, "LOST") for epoch in seqs
        ], start
    await stop(last)


@pytest.mark.parametrize("max_items", [1, 100])
@pytest.mark.asyncio
async def test_a_reader_whose_stream_breaks_at_each_step_gets_each_gap_once(tmp_path: Path, max_items: int) -> None:
    store = FakeStore()
    await killed(tmp_path, store, 1, 1, 2)
    await killed(tmp_path, store, 2, SINCE + 1)
    last = await owner(tmp_path / "3", store, 3, max_items=max_items)
    await last.put(2 * SINCE + 1)
    channel = last.hosted.channel
    saved = SavedCursor(incarnation=channel.incarnation, next_seq=1, low=(1, 0), live_seq=channel.next_seq)
    events: list[object] = []
    for _ in range(20):
        cursor = await opened(last, saved)
        times, gap = await step(last, cursor)
        events += [*times, *([] if gap is None else [gap.first_seq])]
        saved = cursor.saved(channel.incarnation)
    assert events == [1, 2, start_of(2), SINCE + 1, start_of(3), 2 * SINCE + 1]
    await stop(last)


@pytest.mark.asyncio
async def test_a_withdrawn_loss_is_no_gap(tmp_path: Path) -> None:
    store = FakeStore()
    first = await owner(tmp_path / "a", store, 1)
    await first.put(1)
    await stop(first)
    store.failure = "unreachable"
    second = await owner(tmp_path / "b", store, 2)
    await second.put(SINCE + 1)
    store.failure = ""
    await second.find()
    assert await second.subscribed(Bound(None, 1)) == ([1, SINCE + 1], 0)
    assert second.gaps == []
    await second.put(SINCE + 2)
    kill(second)
    third = await owner(tmp_path / "b", store, 3)
    await third.put(2 * SINCE + 1)
    assert await third.subscribed(Bound(None, 1)) == ([1, SINCE + 1, SINCE + 2, 2 * SINCE + 1], 0)
    assert [one.first_seq for one in third.gaps] == [start_of(3)]
    await stop(third)
