from __future__ import annotations

import asyncio

from stampede_rt_runtime.quotas.accounts import Accounts, unlimited
from stampede_rt_runtime.quotas.limits import DEFAULTS
from stampede_rt_runtime.quotas.loop_shares import LoopShares
from stampede_rt_runtime.sockets.frame_buffers import PLACES, FrameBuffers


async def test_a_caller_with_many_long_frames_takes_no_place_of_another() -> None:
    buffers, accounts = FrameBuffers(), Accounts()
    busy, good = accounts.of("busy"), accounts.of("good")
    assert all(buffers.place(busy).take_now() for _ in range(PLACES))
    assert not buffers.place(busy).take_now()
    assert buffers.place(good).take_now()


async def test_a_place_that_was_left_goes_to_the_first_that_waits() -> None:
    buffers, busy = FrameBuffers(), Accounts().of("busy")
    taken = [buffers.place(busy) for _ in range(PLACES)]
    assert all(one.take_now() for one in taken)
    waiting = [asyncio.ensure_future(buffers.place(busy).take()) for _ in range(3)]
    await asyncio.sleep(0)
    waiting[0].cancel()
    taken[0].leave()
    await waiting[1]
    assert not waiting[2].done()
    taken[1].leave()
    await waiting[2]
    taken[2].leave()
    assert buffers.place(busy).take_now()


async def test_a_stream_that_is_cancelled_as_it_gets_a_place_leaves_it_to_the_next() -> None:
    buffers, busy = FrameBuffers(), Accounts().of("busy")
    taken = [buffers.place(busy) for _ in range(PLACES)]
    assert all(one.take_now() for one in taken)
    first, second = (asyncio.ensure_future(buffers.place(busy).take()) for _ in range(2))
    await asyncio.sleep(0)
    taken[0].leave()
    first.cancel()
    await second
    assert first.cancelled()


async def test_members_of_the_cluster_never_wait_for_a_place() -> None:
    place = FrameBuffers().place(unlimited())
    for _ in range(PLACES + 1):
        assert place.take_now()
        await place.take()


async def test_the_bytes_of_a_frame_that_never_ends_count_for_its_caller() -> None:
    now = 0
    accounts = Accounts(DEFAULTS, loop_shares=LoopShares(lambda: now, lambda delay, call: None))
    accounts.of("good").loop_share.spend(1)  # type: ignore[union-attr]  # several callers have work
    place = FrameBuffers().place(accounts.of("busy"))
    begun = 0
    while place.take_now():
        place.leave(2**18)
        begun += 1
    assert 1 <= begun <= 2 * PLACES
