"""Cases of the lease: a host with very many channels and queues loses it, and registers again."""

from __future__ import annotations

import logging

from stampede_rt.v1 import channel_pb2, queue_pb2
from stampede_rt_channel_host.cluster.records import recorded_channel, recorded_queue
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedQueue
from tests.benchmarks.longest_pause.sizes import CHANNELS_NAMED
from tests.benchmarks.longest_pause.watch import Work, until
from tests.support.channel_host.rig import HOST_ID, Rig


async def fence(rig: Rig, channels: int) -> tuple[str, Work]:
    adopt(rig, channels)

    async def work() -> None:
        rig.host.store.fence()
        rig.host.queues.fence()
        await idle(rig)

    return f"a host with {channels:,} channels and as many queues loses its lease", work


async def registration(rig: Rig, channels: int) -> tuple[str, Work]:
    """The answer to the registration names the most channels and queues that an answer may name."""
    adopt(rig, channels)

    async def work() -> None:
        do, last = rig.host.store.scheduler.do, channels - CHANNELS_NAMED
        new_channels = (channel(number, epoch=2) for number in range(last, channels))
        await do(rig.host.store.registering(new_channels, is_complete=False))
        queues = (queue(number, epoch=2) for number in range(last, channels))
        await do(rig.host.queues.registering(queues, is_complete=False))
        await idle(rig)

    return f"a host with {channels:,} channels and as many queues registers again", work


async def elsewhere(rig: Rig, channels: int) -> tuple[str, Work]:
    """The answer to the registration leaves out all channels and queues."""
    adopt(rig, channels)

    async def work() -> None:
        do = rig.host.store.scheduler.do
        await do(rig.host.store.registering((), is_complete=True))
        await do(rig.host.queues.registering((), is_complete=True))
        await idle(rig)

    logging.getLogger("stampede_rt_channel_host").addHandler(logging.NullHandler())
    return f"{channels:,} channels and as many queues went to other hosts when the host registers again", work


async def touched(rig: Rig, channels: int) -> tuple[str, Work]:
    """A sweep after all channels have changed within half a second."""
    adopt(rig, channels)
    store = rig.host.store
    for hosted in store.all():
        store.sweep.touch(hosted)
    return f"the sweep looks at {channels:,} changed channels", store.sweep.sweep


def adopt(rig: Rig, channels: int) -> None:
    """Serve channels and queues without asking the directory."""
    for number in range(channels):
        rig.host.store.adopt(channel(number))
        rig.host.queues.adopt(queue(number))


def channel(number: int, epoch: int = 1) -> RecordedChannel:
    """The directory's record of a channel of this host."""
    name, channel_id = f"c/{number:06}", number.to_bytes(16, "big")
    record = channel_pb2.ChannelRecord(channel_id=channel_id, name=name, incarnation=1, epoch=epoch, host_id=HOST_ID)
    return recorded_channel(record)


def queue(number: int, epoch: int = 1) -> RecordedQueue:
    """The directory's record of a queue of this host."""
    name, queue_id = f"q/{number:06}", number.to_bytes(16, "big")
    return recorded_queue(
        queue_pb2.QueueRecord(queue_id=queue_id, name=name, incarnation=1, epoch=epoch, host_id=HOST_ID)
    )


async def idle(rig: Rig) -> None:
    """Wait until all begun work is done."""
    await until(lambda: not rig.host.store.scheduler._tasks)
