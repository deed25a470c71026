"""One scenario: callers of all kinds on one connection, cut connections meanwhile, and checks at the end."""

from __future__ import annotations

import asyncio
import gc
import random
import sys
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from tests.robustness.fuzz import channel_callers, other_callers
from tests.robustness.fuzz.calling import BOUND_S, CallingClient
from tests.robustness.fuzz.ledger import Ledger
from tests.support.relayed_cluster import RelayedCluster

TRANSPORTS = ("grpc", "best", "tcp")
THREADS = 40
END_S = 10.0


class Scenario:
    """Plays one seed with one client, "aio" or "sync", for `seconds`."""

    def __init__(self, world: RelayedCluster, client: str, seed: int, seconds: float) -> None:
        self._world = world
        self._client = client
        self._seed = seed
        self._seconds = seconds
        self._pool = ThreadPoolExecutor(THREADS) if client == "sync" else None
        self._over = asyncio.Event()
        self._callings: list[CallingClient] = []
        self._complaints: list[str] = []

    async def play(self) -> str:
        """Run the scenario. Returns a line about it. Raises AssertionError."""
        asyncio.get_running_loop().set_exception_handler(self._complain)
        tasks, threads = asyncio.all_tasks(), set(threading.enumerate())
        name = f"fuzz/{self._client}/{self._seed}-{st.now()}"
        calling = self._calling("main")
        rt = await self._connect(calling)
        try:
            await self._call_all(calling, rt, name)
            await self._close_under_load(calling, rt, name)
        finally:
            if self._pool is not None:
                self._pool.shutdown(wait=False, cancel_futures=True)
        await self._nothing_is_left(tasks, threads)
        calls, interrupted, failed = (
            sum(getattr(one, what) for one in self._callings) for what in ("calls", "interrupted", "failed")
        )
        return f"{self._client} seed {self._seed}: {calls} calls, {interrupted} interrupted, {failed} failed"

    def _complain(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self._complaints.append(f"{context.get('message')}: {context.get('exception')!r}")

    def _calling(self, who: str) -> CallingClient:
        self._callings.append(CallingClient(f"{self._seed} {who}", self._pool))
        return self._callings[-1]

    async def _connect(self, calling: CallingClient) -> Any:
        """Connect the scenario's client. The relay cuts connections of gRPC and of TCP sockets, and no Unix socket."""
        transport = TRANSPORTS[self._seed % len(TRANSPORTS)]
        return await calling.plain(
            aio.connect if calling.is_async else st.connect, self._world.address, transport=transport
        )

    async def _call_all(self, calling: CallingClient, rt: Any, name: str) -> None:
        """Run all callers together while connections are cut.

        Then compare their results with the cluster's contents.
        """
        where = {"host": self._world.host}
        a, b = [
            await calling.plain(rt.channel, f"{name}/{one}", max_age="1h", max_bytes=2**30, **where) for one in "ab"
        ]
        queue = await calling.plain(rt.queue, name, lease=other_callers.LEASE, **where)
        eager = await calling.plain(rt.queue, name, prefetch=4)
        group = await calling.plain(rt.group, name, [a, b])
        ledgers = {one: Ledger() for one in (a, b, queue)}
        takers = other_callers.Takers()
        subscribing = asyncio.ensure_future(channel_callers.subscribe(self._calling("subscriber"), a))
        await self._while_cut(
            {
                "p1": lambda calling: channel_callers.put_items(calling, a, ledgers[a], "p1", self._over),
                "p2": lambda calling: channel_callers.put_items(calling, a, ledgers[a], "p2", self._over),
                "p3": lambda calling: channel_callers.put_items(calling, b, ledgers[b], "p3", self._over),
                "producer": lambda calling: channel_callers.put_by_producer(calling, a, ledgers[a], "m", self._over),
                "reader": lambda calling: channel_callers.read(calling, a, self._over),
                "enqueuer": lambda calling: other_callers.enqueue(calling, queue, ledgers[queue], "q", self._over),
                "taker": lambda calling: takers.take(calling, queue, self._over),
                "eager": lambda calling: takers.take(calling, eager, self._over),
                "group": lambda calling: other_callers.read_group(calling, group, self._over),
                "matches": lambda calling: other_callers.follow_matches(calling, group, a, self._over),
                "cuts": lambda calling: other_callers.follow_cuts(calling, group, self._over),
                "guest": self._comes_and_goes,
            }
        )
        await calling.plain(a.put, channel_callers.LAST)
        ledgers[a].accepted.add(channel_callers.LAST)
        for channel in (a, b):
            items = await calling.plain(channel.get, st.OLDEST, st.NEWEST)
            ledgers[channel].judge(Counter(item.payload for item in items))
        seqs = [item.seq for item in await asyncio.wait_for(subscribing, BOUND_S)]
        assert seqs == sorted(set(seqs)), "a subscription doubled an item, or went back"
        accepted = (await calling.plain(a.stats)).accepted
        assert len(seqs) == accepted, f"a subscription gave {len(seqs)} of {accepted} items"
        await self._judge_queue(calling, queue, eager, ledgers[queue], takers)

    async def _while_cut(self, callers: dict[str, Callable[[CallingClient], Coroutine[Any, Any, None]]]) -> None:
        cutting = asyncio.ensure_future(self._world.cut(random.Random(self._seed)))
        tasks = [asyncio.ensure_future(call(self._calling(who))) for who, call in callers.items()]
        try:
            done, _ = await asyncio.wait(tasks, timeout=self._seconds, return_when=asyncio.FIRST_EXCEPTION)
            for task in done:
                task.result()
        finally:
            cutting.cancel()
            self._over.set()
        await asyncio.gather(*tasks)

    async def _judge_queue(self, calling: CallingClient, queue: Any, eager: Any, ledger: Ledger, takers: Any) -> None:
        await calling.plain(eager.aclose if calling.is_async else eager.close)
        await takers.take_the_rest(calling, queue)
        seen = takers.acknowledged.copy()
        seen.update(dict.fromkeys(takers.unsure - seen.keys(), 1))
        ledger.open |= takers.unsure
        ledger.judge(seen)

    async def _comes_and_goes(self, calling: CallingClient) -> None:
        """Open separate connections, and close each in the middle of its calls."""
        while not self._over.is_set():
            rt = await calling.outcome("connect", self._connect(calling), 5)
            if not hasattr(rt, "channel"):
                continue
            name = f"fuzz/guest/{self._client}/{self._seed}"
            channel = await calling.outcome("open", calling.plain(rt.channel, name, host=self._world.host), 1)
            puts = []
            if hasattr(channel, "put"):
                puts = [asyncio.ensure_future(calling.plain(channel.put, b"x", timeout=1)) for _ in range(3)]
            close = rt.aclose if calling.is_async else rt.close
            await calling.outcome("close", calling.plain(close), 5)
            await calling.plain(close)
            for put in puts:
                await calling.ended("put beside a close", put, 1)

    async def _close_under_load(self, calling: CallingClient, rt: Any, name: str) -> None:
        """Check that waiting callers get an error when the connection is closed."""
        channel = await calling.plain(rt.channel, f"{name}/a")
        queue = await calling.plain(rt.queue, name)
        makes = [
            partial(channel.put, b"x"), partial(channel.newest, channel_end(), timeout=None), queue.get, channel.stats,
            partial(channel.get, st.now(), st.now() + 10**12, timeout=60, complete=True), partial(queue.put, b"x"),
        ]  # fmt: skip
        calls = [asyncio.ensure_future(calling.plain(make)) for make in makes]
        for _ in range(calling.rng.randrange(200)):
            await asyncio.sleep(0)
        await calling.outcome("close", calling.plain(rt.aclose if calling.is_async else rt.close), 5)
        await calling.plain(rt.aclose if calling.is_async else rt.close)
        for call in calls:
            await calling.ended("call beside a close", call, 0)

    async def _nothing_is_left(self, tasks: set[Any], threads: set[threading.Thread]) -> None:
        gc.collect()
        left = asyncio.all_tasks() - tasks
        if left:
            _, left = await asyncio.wait(left, timeout=END_S)
        assert not left, f"tasks that never end: {left}"
        threads_left = await asyncio.to_thread(_joined, _of_clients(threads))
        assert not threads_left, f"threads that never end:{''.join(map(_stack, threads_left))}"
        gc.collect()
        assert not self._complaints, self._complaints[:5]
        async with asyncio.timeout(END_S), aio.connect(self._world.address) as rt:
            async for stats in _stats_of_all(rt):
                assert stats is not None


def channel_end() -> int:
    """An instant later than every item of the scenario."""
    return st.now() + 10**9


def _joined(threads: list[threading.Thread]) -> list[threading.Thread]:
    """The threads that have not ended after END_S."""
    ends_s = time.monotonic() + END_S
    for thread in threads:
        _join(thread, ends_s)
    return [thread for thread in threads if thread.is_alive()]


def _join(thread: threading.Thread, ends_s: float) -> None:
    while True:  # ends with the thread, or at `ends_s`
        try:
            return thread.join(max(0.0, ends_s - time.monotonic()))
        except RuntimeError:  # a thread is listed a moment before it has started
            time.sleep(0)


def _stack(thread: threading.Thread) -> str:
    frame = sys._current_frames().get(thread.ident or 0)
    return f"\n{thread.name}\n{''.join(traceback.format_stack(frame)[-4:])}"


def _of_clients(before: set[threading.Thread]) -> list[threading.Thread]:
    """The threads that a client started.

    They do not include the poller of grpc.aio, because a process has only one. The poller lives for as long as any
    object of grpc.aio. Such an object may come from an earlier test, if no garbage collection has found it yet.
    """
    kept, poller = ("stampede dropped", "asyncio_"), "(_poll_wrapper)"
    started = [one for one in set(threading.enumerate()) - before if not one.name.startswith(kept)]
    pollers = [one for one in started if one.name.endswith(poller)]
    return [one for one in started if one not in pollers[:1]]


async def _stats_of_all(rt: Any) -> Any:
    """The stats of each channel, once no caller waits or subscribes there any more."""
    for info in await rt.channels("fuzz/*"):
        channel = await rt.channel(info.name, create=False)
        while (stats := await channel.stats()).subscriptions or stats.waiting_gets or stats.waiting_puts:
            pass
        yield stats
