"""The cost of a put until the host has made the message of each reader."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from functools import partial
from typing import Any, cast

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt_bench.growth.own_channels import OwnChannels, cpu_us, get, put, run_of
from stampede_rt_bench.measuring import NANOS_PER_US, PAYLOAD_BYTES, Spread, quiet
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.channels.subscriptions.subscription import Subscription

CREDIT_BYTES = 2**62


class _Messages:
    """Counts the messages that the host writes to all readers."""

    def __init__(self) -> None:
        self._missing = 0
        self._all_came = asyncio.Event()

    def expect(self, messages: int) -> None:
        self._missing = messages
        self._all_came.clear()

    async def wait(self) -> None:
        """Wait for the expected messages."""
        await self._all_came.wait()

    def count(self) -> None:
        self._missing -= 1
        if not self._missing:
            self._all_came.set()


class _Stream:
    """A stream to a reader that takes every message immediately, or takes only the first one."""

    def __init__(self, messages: _Messages, *, stalls: bool) -> None:
        self._messages = messages
        self._stalls = stalls
        self._is_open = False

    async def read(self) -> bytes:
        await asyncio.Event().wait()
        raise AssertionError("a reader sends nothing, so this wait has no end")

    async def write(self, message: bytes) -> None:
        if self._stalls and self._is_open:
            await asyncio.Event().wait()
        self._is_open = True
        self._messages.count()


class _Store:
    """The parts of a host's store that a subscription uses."""

    def __init__(self, own: OwnChannels) -> None:
        self.scheduler = own.scheduler
        self.readers, self.multicasts = Readers(), None

    def now(self) -> int:
        return time.time_ns()

    def find_readable(self, channel_id: bytes, epoch: int, demand: object) -> None:
        """Do nothing: the channel stays at this host."""


def measure_readers(counts: Sequence[int], operations: int, runs: int) -> dict[int, dict[str, Spread]]:
    """By the number of readers: the cost of a put, that cost for each reader, and the cost of a get of the newest."""
    return {count: asyncio.run(_with_readers(count, operations, runs)) for count in counts}


async def _with_readers(count: int, operations: int, runs: int) -> dict[str, Spread]:
    puts = max(3, 2 * operations // count)
    costs_us, stalled_us = [], []
    for _ in range(runs):
        async with _reading(count, stalled=True) as (channel, messages):
            stalled_us.append(await _put(channel, messages, count, puts))
        async with _reading(count, stalled=False) as (channel, messages):
            costs_us.append(await _put(channel, messages, count, puts))
    async with _reading(count, stalled=False) as (channel, _):
        gets = cpu_us(partial(_get, channel), times=operations, runs=runs)
    return {
        "put, until all readers have it": Spread.of(costs_us),
        "beside a stalled reader": Spread.of(stalled_us),
        "its part for one reader": Spread.of([cost / count for cost in costs_us]),
        "get of the newest": gets,
    }


def _get(channel: HostedChannel, _: int) -> None:
    get(channel)


@asynccontextmanager
async def _reading(count: int, *, stalled: bool) -> AsyncIterator[tuple[HostedChannel, _Messages]]:
    """A channel with `count` readers that have a few items. With `stalled` one more reader takes nothing."""
    own, messages = OwnChannels(), _Messages()
    channel = own.open(Policy(max_items=100))
    streams = [_Stream(messages, stalls=number >= count) for number in range(count + stalled)]
    messages.expect(len(streams))  # the first message to each reader says that the subscription is open
    readers = [asyncio.create_task(_read(own, channel, stream)) for stream in streams]
    await messages.wait()
    try:
        with quiet():
            await _put(channel, messages, count, 10)
            yield channel, messages
    finally:
        for reader in readers:
            reader.cancel()
        await asyncio.gather(*readers, return_exceptions=True)


async def _read(own: OwnChannels, channel: HostedChannel, stream: _Stream) -> None:
    task = asyncio.current_task()
    assert task is not None
    opening = pb.SubscribeRequest(open=pb.SubscribeOpen(epoch=1), credit_bytes=CREDIT_BYTES)
    await Subscription(channel, cast(Any, _Store(own)), cast(Any, None), cast(Any, stream), OpenStream(task)).run(
        opening
    )


async def _put(channel: HostedChannel, messages: _Messages, readers: int, puts: int) -> float:
    """The microseconds of CPU time that a put takes until all readers have it."""
    encoded = run_of(PAYLOAD_BYTES)
    began = time.thread_time_ns()
    for _ in range(puts):
        messages.expect(readers)
        put(channel, encoded)
        await messages.wait()
    return (time.thread_time_ns() - began) / puts / NANOS_PER_US
