"""Functions that the client calls for each new item (`on_item`) or to get the next item (`sample`), on both clients."""

from __future__ import annotations

import asyncio
import inspect
import logging
import os
import threading
from collections.abc import Callable
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from tests.contract.surfaces import Surface
from tests.support.waiting import pause

MS = 1_000_000
pytestmark = pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)


class CallRecorder:
    """A function that notes its arguments. Any thread or task may call it."""

    def __init__(self, then: Callable[[Any], Any] = lambda _: None) -> None:
        self.values: list[Any] = []
        self._then = then
        self._changed = threading.Condition()

    def __call__(self, value: Any = None) -> Any:
        with self._changed:
            self.values.append(value)
            self._changed.notify_all()
        return self._then(value)

    async def until(self, count: int) -> list[Any]:
        def wait() -> bool:
            with self._changed:
                return self._changed.wait_for(lambda: len(self.values) >= count, 10)

        assert await asyncio.to_thread(wait), f"called {len(self.values)} times"
        return self.values


async def joined(handle: Any) -> bool:
    if inspect.iscoroutinefunction(handle.join):
        return bool(await handle.join(10))
    return bool(await asyncio.to_thread(handle.join, 10))


async def until(condition: Callable[[], bool], channel: Any) -> None:
    async with asyncio.timeout(45):
        while not condition():
            await channel.stats()
            await pause()


async def test_a_function_is_called_for_each_new_item(surface: Surface) -> None:
    channel = await surface.channel(codec="json")
    await channel.put("before")
    called = CallRecorder()
    handle = await channel.on_item(called)
    for number in range(20):
        await channel.put(number)
    assert [item.value for item in await called.until(20)] == list(range(20))
    await until(lambda: handle.delivered == 20, channel)
    handle.cancel()
    assert await joined(handle)
    assert (handle.active, handle.failures, handle.error) == (False, 0, None)


async def test_calls_of_one_callback_never_overlap(surface: Surface) -> None:
    running, overlaps = threading.Semaphore(1), list[int]()

    def alone(item: st.Item) -> None:
        if not running.acquire(blocking=False):
            overlaps.append(item.seq)
            return
        for _ in range(50):  # let other threads run
            os.sched_yield()
        running.release()

    channel = await surface.channel()
    called = CallRecorder(alone)
    handle = await channel.on_item(called)
    await asyncio.gather(*(channel.put(b"%d" % number) for number in range(30)))
    assert [item.seq for item in await called.until(30)] == [*range(1, 31)]
    assert overlaps == []
    handle.cancel()
    assert await joined(handle)


async def test_held_items_come_first_when_a_start_is_given(surface: Surface) -> None:
    channel = await surface.channel()
    first = await channel.put(b"held")
    called = CallRecorder()
    handle = await channel.on_item(called, st.OLDEST, payloads=False)
    await channel.put(b"new")
    assert [item.payload_length_bytes for item in await called.until(2)] == [4, 3]
    handle.cancel()
    later_calls = CallRecorder()
    resumed = await channel.on_item(later_calls, after=first)
    assert [item.payload for item in await later_calls.until(1)] == [b"new"]
    resumed.cancel()
    assert await joined(handle)
    assert await joined(resumed)


async def test_an_error_in_a_callback_is_logged_and_counted_and_later_items_still_reach_it(
    surface: Surface, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(item: st.Item) -> None:
        if item.payload != b"last":
            raise ZeroDivisionError("by the function")

    channel = await surface.channel()
    called = CallRecorder(fail)
    with caplog.at_level(logging.ERROR, "stampede_rt"):
        handle = await channel.on_item(called)
        for payload in (b"1", b"2", b"3", b"last"):
            await channel.put(payload)
        await called.until(4)
        await until(lambda: handle.delivered == 1, channel)
    assert (handle.failures, type(handle.last_failure), handle.active) == (3, ZeroDivisionError, True)
    logged = [record.getMessage() for record in caplog.records]
    assert len(logged) == 2  # the log has the 1st and 2nd failure, and would have the 4th, the 8th and so on
    assert channel.name in logged[0]
    handle.cancel()
    assert await joined(handle)


async def test_no_call_of_a_callback_begins_after_its_cancel(surface: Surface) -> None:
    channel = await surface.channel()
    called = CallRecorder(lambda item: handle.cancel())
    handle = await channel.on_item(called, st.OLDEST)
    for payload in (b"1", b"2", b"3"):
        await channel.put(payload)
    await called.until(1)
    assert await joined(handle)
    assert (len(called.values), handle.active) == (1, False)


async def test_a_slow_callback_learns_how_many_items_retention_removed_meanwhile(surface: Surface) -> None:
    channel = await surface.channel(max_items=2)
    first = await channel.put(b"0")
    for number in range(1, 8):
        await channel.put(str(number).encode())
    called = CallRecorder()
    handle = await channel.on_item(called, after=first)
    assert [item.payload for item in await called.until(2)] == [b"6", b"7"]
    assert handle.dropped == 5
    handle.cancel()
    assert await joined(handle)


async def test_a_callback_ends_with_the_reason_when_its_channel_is_deleted(
    surface: Surface, caplog: pytest.LogCaptureFixture
) -> None:
    channel = await surface.channel()
    handle = await channel.on_item(CallRecorder())
    with caplog.at_level(logging.ERROR, "stampede_rt"):
        await channel.delete()
        assert await joined(handle)
    assert isinstance(handle.error, st.ChannelNotFound)
    assert any("has ended" in record.getMessage() for record in caplog.records)


async def test_closing_the_connection_ends_callbacks_and_samplers_without_an_error(
    request: pytest.FixtureRequest, surface: Surface, caplog: pytest.LogCaptureFixture
) -> None:
    def blocking(address: str) -> tuple[Any, Any]:
        with st.connect(address) as rt:
            channel = rt.channel(f"{name}/of-the-blocking-client")
            return channel.on_item(print), channel.sample(lambda: None, every="10s")

    async def awaited(address: str) -> tuple[Any, Any]:
        async with aio.connect(address) as rt:
            channel = await rt.channel(f"{name}/of-the-awaited-client")
            return await channel.on_item(print), channel.sample(lambda: None, every="10s")

    name, address = (await surface.channel()).name, request.getfixturevalue("cluster").address
    for handles in (await asyncio.to_thread(blocking, address), await awaited(address)):
        assert [(handle.active, handle.error) for handle in handles] == [(False, None)] * 2
    assert not caplog.records


async def test_a_callback_must_be_a_function(surface: Surface) -> None:
    channel = await surface.channel()
    with pytest.raises(st.InvalidArgument, match="function"):
        await channel.on_item("print")
    with pytest.raises(st.InvalidArgument, match="mode"):
        await channel.on_item(print, mode="some")
    with pytest.raises(st.InvalidArgument, match="every"):
        await channel.sample(print, every="0s")
    with pytest.raises(st.InvalidArgument, match="function"):
        await channel.sample(None)


async def test_sampling_puts_the_results_of_the_function(surface: Surface) -> None:
    channel = await surface.channel(codec="json")
    values = iter([{"n": 1}, None, {"n": 2}])
    handle = await channel.sample(lambda: next(values, None), every="1ms")
    second = await channel.get(st.OLDEST, st.NEWEST, timeout=10)
    second = await channel.newest(after=second[0], timeout=10)
    assert second.value == {"n": 2}
    handle.cancel()
    assert await joined(handle)
    assert (handle.samples, handle.failures, handle.active) == (2, 0, False)


async def test_sampling_continues_after_failures(surface: Surface, caplog: pytest.LogCaptureFixture) -> None:
    outcomes = iter([ZeroDivisionError(), "text", b"good"])

    def sample() -> Any:
        outcome = next(outcomes, None)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    channel = await surface.channel()
    with caplog.at_level(logging.ERROR, "stampede_rt"):
        handle = await channel.sample(sample, every="1ms")
        assert (await channel.newest(timeout=10)).payload == b"good"
    handle.cancel()
    assert await joined(handle)
    assert (handle.failures, type(handle.last_failure)) == (2, st.InvalidArgument)
    assert "continues after failure 1" in caplog.records[0].getMessage()


async def test_sampling_for_a_deleted_channel_ends_with_a_reason_in_the_log(
    surface: Surface, caplog: pytest.LogCaptureFixture
) -> None:
    channel = await surface.channel()
    with caplog.at_level(logging.ERROR, "stampede_rt"):
        handle = await channel.sample(lambda: b"x", every="1ms")
        await channel.newest(timeout=10)
        await channel.delete()
        assert await joined(handle)
    assert isinstance(handle.error, st.ChannelNotFound)
