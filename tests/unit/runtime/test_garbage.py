"""The garbage collector is run in small portions."""

from __future__ import annotations

import asyncio
import gc
from collections import deque

from stampede_rt_runtime.garbage import (
    FULL_INTERVAL_SECONDS,
    INTERVAL_SECONDS_MAX,
    INTERVAL_SECONDS_MIN,
    LONG_SECONDS,
    CollectionPace,
    GarbageCollection,
)


class Item:
    """An object like the items of a channel, which Python always tracks."""

    def __init__(self, held: object) -> None:
        self.held = held


async def test_objects_that_replace_others_are_collected_in_small_portions() -> None:
    thresholds = gc.get_threshold()
    held = deque((Item(at) for at in range(20_000)), maxlen=20_000)
    async with GarbageCollection() as collection:
        for at in range(20_000):
            held.append(Item(at))  # the number of held items stays the same
            if at % 1000 == 0:
                collection.collect()
                assert len(gc.get_objects(0)) < 4000
    assert gc.get_threshold() == thresholds


async def test_the_event_loop_collects_reference_cycles() -> None:
    gone = asyncio.Event()
    loop = asyncio.get_running_loop()

    class Ending(Item):
        def __del__(self) -> None:
            loop.call_soon_threadsafe(gone.set)

    async with GarbageCollection():
        lost = Ending(None)
        lost.held = lost
        del lost
        await gone.wait()


def test_the_next_collection_starts_earlier_after_a_long_one_and_later_after_a_short_one() -> None:
    pace = CollectionPace(0.0)
    assert pace.interval_s == INTERVAL_SECONDS_MAX
    intervals = []
    for _ in range(10):
        pace.took(0, 2 * LONG_SECONDS, 0.0)
        intervals.append(pace.interval_s)
    assert intervals[0] == INTERVAL_SECONDS_MAX / 2
    assert intervals[-1] == INTERVAL_SECONDS_MIN
    pace.took(0, LONG_SECONDS / 2, 0.0)
    assert pace.interval_s == INTERVAL_SECONDS_MIN
    for _ in range(10):
        pace.took(0, 0.0, 0.0)
    assert pace.interval_s == INTERVAL_SECONDS_MAX


def test_objects_of_a_burst_after_an_idle_time_are_collected_in_small_portions() -> None:
    """1000 streams that all write a message replace some 600 objects in each ms, and do not change their number."""
    pace, objects_per_second, seconds_per_object = CollectionPace(0.0), 600_000, 1.5e-7
    for _ in range(100):
        pace.took(0, 0.0, 0.0)
    moved, largest = 0.0, 0.0
    for _ in range(100):
        young = objects_per_second * pace.interval_s
        generation = pace.next_generation(0.0)
        seconds = (young + (moved if generation else 0.0)) * seconds_per_object
        moved = 0.0 if generation else moved + young
        largest = max(largest, seconds)
        pace.took(generation, seconds, 0.0)
    assert largest <= 6 * LONG_SECONDS


def test_generation_1_is_collected_after_enough_work_on_generation_0() -> None:
    pace = CollectionPace(0.0)
    collected = []
    for _ in range(9):
        generation = pace.next_generation(0.0)
        collected.append(generation)
        pace.took(generation, LONG_SECONDS / 2, 0.0)
    assert collected == [0, 0, 1] * 3


def test_all_objects_are_collected_rarely_and_only_if_many_may_be_new() -> None:
    pace = CollectionPace(0.0)
    assert pace.next_generation(10 * FULL_INTERVAL_SECONDS) == 0
    pace.took(1, LONG_SECONDS, 0.0)
    assert pace.next_generation(FULL_INTERVAL_SECONDS - 1) == 0
    assert pace.next_generation(FULL_INTERVAL_SECONDS) == 2
    pace.took(2, 8 * LONG_SECONDS, FULL_INTERVAL_SECONDS)
    pace.took(1, LONG_SECONDS, 0.0)
    assert pace.next_generation(3 * FULL_INTERVAL_SECONDS) == 0
    pace.took(1, 2 * LONG_SECONDS, 0.0)
    assert pace.next_generation(3 * FULL_INTERVAL_SECONDS) == 2
