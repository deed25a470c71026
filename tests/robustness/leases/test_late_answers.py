"""The directory's answer to a host can be late.

The host's lease has ended, another host has the channel, and the host has registered again. Then an older answer says
that the channel still belongs to this host.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from stampede_rt.errors import StaleBinding
from stampede_rt.v1 import channel_pb2
from stampede_rt_channel_host.channels.channel_changes import ChannelChanges
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.records import policy_change, recorded_channel
from stampede_rt_channel_host.core.channel import run_to_end
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_runtime.clock import SystemClock

ME, OTHER, CHANNEL = b"m" * 16, b"o" * 16, b"c" * 16


def record(host_id: bytes, epoch: int, *, incarnation: int = 7) -> RecordedChannel:
    message = channel_pb2.ChannelRecord(
        channel_id=CHANNEL, name="cam", host_id=host_id, epoch=epoch, incarnation=incarnation, spec_version=1
    )
    return recorded_channel(message)


class SlowDirectory:
    """Each request waits until the test answers it. `requests`: the futures of the waiting requests."""

    def __init__(self) -> None:
        self.requests: asyncio.Queue[asyncio.Future[RecordedChannel]] = asyncio.Queue()

    async def resolve(self, channel_id: bytes) -> RecordedChannel:
        answer: asyncio.Future[RecordedChannel] = asyncio.get_running_loop().create_future()
        self.requests.put_nowait(answer)
        return await answer

    async def update(self, channel_id: bytes, *_: Any, **__: Any) -> RecordedChannel:
        return await self.resolve(channel_id)


def store_over(directory: SlowDirectory) -> ChannelStore:
    identity = HostIdentity(host_id=ME, name="me", boot_incarnation=1)
    return ChannelStore(
        identity,
        directory,  # type: ignore[arg-type]  # the store calls only these methods
        SystemClock(),
        lease_held=lambda: True,
        memory=MemoryBudget(2**20),
    )


async def test_an_answer_from_before_a_registration_is_not_served() -> None:
    directory = SlowDirectory()
    store = store_over(directory)
    binding = asyncio.create_task(store.bind(CHANNEL, 1))
    late = await directory.requests.get()
    run_to_end(store.registering([], is_complete=True))  # the lease had ended, and another host has the channel
    late.set_result(record(ME, 1))
    second_request = await asyncio.wait_for(directory.requests.get(), 5)
    second_request.set_result(record(OTHER, 2, incarnation=8))
    with pytest.raises(StaleBinding):
        await binding
    with pytest.raises(StaleBinding):
        store.find(CHANNEL, 1)


async def test_a_change_whose_answer_is_older_than_a_registration_does_not_bring_the_channel_back() -> None:
    directory = SlowDirectory()
    store = store_over(directory)
    changes = ChannelChanges(store, directory)  # type: ignore[arg-type]
    await answered(directory, lambda: store.bind(CHANNEL, 1), record(ME, 1))
    change = asyncio.create_task(
        changes.configure(CHANNEL, 1, policy_change(channel_pb2.ChannelSpec()), b"r" * 16, time.monotonic())
    )
    late = await directory.requests.get()
    run_to_end(store.registering([], is_complete=True))
    late.set_result(record(ME, 1))
    second_request = await asyncio.wait_for(directory.requests.get(), 5)
    second_request.set_result(record(OTHER, 2, incarnation=8))
    with pytest.raises(StaleBinding):
        await change
    with pytest.raises(StaleBinding):
        store.find(CHANNEL, 1)


async def answered(
    directory: SlowDirectory, ask: Callable[[], Coroutine[Any, Any, Any]], answer: RecordedChannel
) -> None:
    asking = asyncio.create_task(ask())
    (await directory.requests.get()).set_result(answer)
    await asking


async def test_a_host_that_registers_again_and_again_gives_up_the_lookup() -> None:
    directory = SlowDirectory()
    store = store_over(directory)
    binding = asyncio.create_task(store.bind(CHANNEL, 1))
    while not binding.done():
        request = asyncio.create_task(directory.requests.get())
        await asyncio.wait({request, binding}, return_when=asyncio.FIRST_COMPLETED)
        if not request.done():
            request.cancel()
            break
        run_to_end(store.registering([], is_complete=True))
        request.result().set_result(record(ME, 1))
    with pytest.raises(StaleBinding, match="resolve it again"):
        await binding


async def test_a_host_that_registers_while_it_opens_an_archive_does_not_serve_the_channel() -> None:
    """The lease ended, and another host got the channel. In an earlier version, the host served the former epoch."""
    directory = SlowDirectory()
    store = store_over(directory)

    async def opened_slowly(*_: Any) -> None:
        run_to_end(store.registering([], is_complete=True))

    store.recordings.prepare = opened_slowly  # type: ignore[method-assign]
    binding = asyncio.create_task(store.bind(CHANNEL, 1))
    (await directory.requests.get()).set_result(record(ME, 1))
    with pytest.raises(StaleBinding, match="changed while its archive was opened"):
        await binding
    assert store.known(CHANNEL) is None
