"""Many calls at the same time become few calls to the directory."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from stampede_rt.errors import StaleBinding, StampedeError, Unavailable
from stampede_rt_channel_host.cluster import gathered_calls
from stampede_rt_channel_host.cluster.gathered_calls import GatheredCalls


class Directory:
    """Answers each number with its square once `go` is set, and refuses negative ones. The next call raises `fails`."""

    def __init__(self) -> None:
        self.calls: list[list[int]] = []
        self.go = asyncio.Event()
        self.fails: Exception | None = None

    async def ask(self, numbers: Sequence[int]) -> list[int | StampedeError]:
        self.calls.append([*numbers])
        await self.go.wait()
        if (fails := self.fails) is not None:
            self.fails = None
            raise fails
        return [StaleBinding(f"no {one}") if one < 0 else one * one for one in numbers]


async def begun_lookups(calls: GatheredCalls[int, int], *numbers: int) -> list[asyncio.Task[int]]:
    """Tasks that ask for these numbers, once all of them have begun."""
    tasks = [asyncio.create_task(calls.ask(one)) for one in numbers]
    for _ in range(3):
        await asyncio.sleep(0)
    return tasks


async def test_lookups_that_arrive_during_a_call_share_the_next_calls() -> None:
    directory = Directory()
    calls = GatheredCalls(directory.ask, 2)
    tasks = await begun_lookups(calls, 1) + await begun_lookups(calls, 2, 3, 4)
    directory.go.set()
    assert await asyncio.gather(*tasks) == [1, 4, 9, 16]
    assert directory.calls == [[1], [2, 3], [4]]
    assert await calls.ask(5) == 25


async def test_each_lookup_gets_its_own_answer_or_error() -> None:
    directory = Directory()
    tasks = await begun_lookups(GatheredCalls(directory.ask, 8), 0, 2, -3, 4)
    directory.go.set()
    done = await asyncio.gather(*tasks, return_exceptions=True)
    assert [str(one) for one in done] == ["0", "4", "no -3", "16"]


@pytest.mark.parametrize("fails", [Unavailable("no supernode"), RuntimeError("a defect")])
async def test_a_failed_call_fails_its_own_lookups_and_no_later_ones(fails: Exception) -> None:
    directory = Directory()
    calls = GatheredCalls(directory.ask, 8)
    first, later = await begun_lookups(calls, 1), await begun_lookups(calls, 2, 3)
    directory.fails = fails
    directory.go.set()
    with pytest.raises(StampedeError, match=str(fails)) as caught:
        await first[0]
    assert caught.value.retryable, "the directory may have done it, so the caller has to ask again"
    assert await asyncio.gather(*later) == [4, 9]


async def test_a_cancelled_lookup_is_left_out_and_delays_no_other_lookup() -> None:
    directory = Directory()
    calls = GatheredCalls(directory.ask, 8)
    first, (gone, stays) = await begun_lookups(calls, 1), await begun_lookups(calls, 2, 3)
    first[0].cancel()
    gone.cancel()
    directory.go.set()
    assert await stays == 9
    assert directory.calls == [[1], [3]]


async def test_questions_that_come_soon_after_a_call_wait_for_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    is_time = asyncio.Event()

    async def sleep(seconds: float) -> None:
        assert 0 < seconds <= 3600
        await is_time.wait()

    monkeypatch.setattr(gathered_calls, "sleep", sleep)
    directory = Directory()
    directory.go.set()
    calls = GatheredCalls(directory.ask, 3, interval_s=3600)
    assert await calls.ask(1) == 1, "a lone request does not wait"
    soon = await begun_lookups(calls, 2) + await begun_lookups(calls, 3)
    assert directory.calls == [[1]]
    is_time.set()
    assert await asyncio.gather(*soon) == [4, 9]
    assert directory.calls == [[1], [2, 3]]


async def test_enough_questions_for_a_whole_call_do_not_wait() -> None:
    directory = Directory()
    directory.go.set()
    calls = GatheredCalls(directory.ask, 3, interval_s=3600)
    assert await calls.ask(1) == 1
    assert await asyncio.gather(*await begun_lookups(calls, 2, 3, 4)) == [4, 9, 16]


@pytest.mark.parametrize(("took_s", "waits_s"), [(0.001, 0.01), (0.005, 0.02), (1.0, 0.025)])
async def test_after_a_long_call_more_questions_wait_for_each_other(
    took_s: float, waits_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, now_s, waits = asyncio.get_running_loop(), 0.0, []

    async def ask(requests: Sequence[int]) -> list[int | StampedeError]:
        nonlocal now_s
        now_s += took_s
        return [*requests]

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    monkeypatch.setattr(gathered_calls, "sleep", sleep)
    calls = GatheredCalls(ask, 8, interval_s=0.01)
    with monkeypatch.context() as patch:
        patch.setattr(loop, "time", lambda: now_s)
        assert await calls.ask(1) == 1
        assert await calls.ask(2) == 2
    assert [one + took_s for one in waits] == pytest.approx([waits_s] if waits_s > took_s else [])
