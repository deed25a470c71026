"""The buffers and places for long frames, which callers share."""

from __future__ import annotations

import asyncio

from stampede_rt_runtime.quotas.accounts import Accounts, unlimited
from stampede_rt_runtime.quotas.limits import DEFAULTS
from stampede_rt_runtime.quotas.loop_shares import LoopShares
from stampede_rt_runtime.sockets.frame_buffers import BUFFERS_KEPT, PLACE_BYTES, PLACES, FrameBuffers


async def test_a_caller_with_many_long_frames_does_not_take_buffers_of_another_caller() -> None:
    buffers, accounts = FrameBuffers(), Accounts()
    busy, good = accounts.of("busy"), accounts.of("good")
    assert all(buffers.place(busy).take_now(PLACE_BYTES) for _ in range(PLACES))
    assert not buffers.place(busy).take_now(PLACE_BYTES)
    assert buffers.place(good).take_now(PLACE_BYTES)


async def test_a_free_frame_buffer_goes_to_the_first_waiting_stream() -> None:
    buffers, busy = FrameBuffers(), Accounts().of("busy")
    taken = [buffers.place(busy) for _ in range(PLACES)]
    assert all(one.take_now(PLACE_BYTES) for one in taken)
    waiting = [asyncio.ensure_future(buffers.place(busy).take(PLACE_BYTES)) for _ in range(3)]
    await asyncio.sleep(0)
    waiting[0].cancel()
    taken[0].leave()
    await waiting[1]
    assert not waiting[2].done()
    taken[1].leave()
    await waiting[2]
    taken[2].leave()
    assert buffers.place(busy).take_now(PLACE_BYTES)


async def test_a_stream_that_is_cancelled_when_it_gets_a_buffer_passes_it_to_the_next_stream() -> None:
    buffers, busy = FrameBuffers(), Accounts().of("busy")
    taken = [buffers.place(busy) for _ in range(PLACES)]
    assert all(one.take_now(PLACE_BYTES) for one in taken)
    first, second = (asyncio.ensure_future(buffers.place(busy).take(PLACE_BYTES)) for _ in range(2))
    await asyncio.sleep(0)
    taken[0].leave()
    first.cancel()
    await second
    assert first.cancelled()


async def test_a_longer_frame_takes_more_buffers_and_later_frames_wait() -> None:
    buffers, busy = FrameBuffers(), Accounts().of("busy")
    half, other, whole, small = (buffers.place(busy) for _ in range(4))
    assert half.take_now(PLACES * PLACE_BYTES // 2)
    assert other.take_now(PLACE_BYTES + 1)  # takes two places
    waiting = [asyncio.ensure_future(whole.take(PLACES * PLACE_BYTES))]
    await asyncio.sleep(0)
    assert not small.take_now(1), "the long frame came first"
    waiting.append(asyncio.ensure_future(small.take(1)))
    half.leave()
    await asyncio.sleep(0)
    assert not waiting[0].done()
    other.leave()
    await waiting[0]
    assert not waiting[1].done()
    whole.leave()
    await waiting[1]
    small.leave()
    assert whole.take_now(PLACES * PLACE_BYTES + 1), "a frame that needs more places than there are takes all"


async def test_the_next_frame_is_read_when_a_long_frame_stops_waiting() -> None:
    buffers, busy = FrameBuffers(), Accounts().of("busy")
    half, whole, small = (buffers.place(busy) for _ in range(3))
    assert half.take_now(PLACES * PLACE_BYTES // 2)
    waits = [asyncio.ensure_future(whole.take(PLACES * PLACE_BYTES)), asyncio.ensure_future(small.take(1))]
    await asyncio.sleep(0)
    waits[0].cancel()
    await waits[1]


async def test_services_of_the_cluster_never_wait_for_a_buffer() -> None:
    place = FrameBuffers().place(unlimited())
    for _ in range(PLACES + 1):
        assert place.take_now(PLACE_BYTES)
        await place.take(PLACE_BYTES)


async def test_the_bytes_of_a_frame_that_never_ends_count_for_its_caller() -> None:
    now = 0
    accounts = Accounts(DEFAULTS, loop_shares=LoopShares(lambda: now, lambda delay, call: None))
    accounts.of("good").loop_share.spend(1)  # type: ignore[union-attr]  # several callers have work
    place = FrameBuffers().place(accounts.of("busy"))
    begun = 0
    while place.take_now(PLACE_BYTES):
        place.leave(2**18)
        begun += 1
    assert 1 <= begun <= 2 * PLACES


def test_later_frames_reuse_a_buffer_unless_a_view_of_it_still_exists() -> None:
    buffers = FrameBuffers()
    buffer = buffers.take_buffer(1000)
    assert len(buffer) == 1000
    buffers.give_back(buffer)
    assert buffers.take_buffer(900) is buffer
    view = memoryview(buffer)[10:20]
    buffers.give_back(buffer)
    assert buffers.take_buffer(900) is not buffer
    assert len(buffer) == 1000
    view.release()
    assert buffers.take_buffer(1001) is not buffer
    assert buffers.take_buffer(1000) is buffer


def test_only_a_few_of_the_longest_free_buffers_are_kept() -> None:
    buffers = FrameBuffers()
    taken = [buffers.take_buffer(100 * (at % 7 + 1)) for at in range(7)]
    for buffer in taken:
        buffers.give_back(buffer)
    kept = {id(buffers.take_buffer(1)) for _ in range(BUFFERS_KEPT)}
    assert kept == {id(buffer) for buffer in taken[-BUFFERS_KEPT:]}
