"""Cases of items that leave: limits, consumption, and the deletion of a channel."""

from __future__ import annotations

import asyncio

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from tests.benchmarks.longest_pause.filling import fill, in_order, opened
from tests.benchmarks.longest_pause.sizes import (
    BLOCKED_GETS,
    CALLS,
    MORE_OBJECTS,
    PUTS_PER_TURN,
)
from tests.benchmarks.longest_pause.watch import PATIENCE_SECONDS, Work
from tests.support.channel_host.rig import OpenedChannel, Rig, run_of


async def configure(rig: Rig, channel: OpenedChannel, **limits: int) -> None:
    """Change the channel's retention."""
    request = gate_pb.ConfigureChannelRequest(
        request_id=b"0123456789abcdef",
        channel_id=channel.channel_id,
        epoch=channel.epoch,
        spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(**limits)),
    )
    await rig.gate.ConfigureChannel(request)


async def smaller_limit(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)

    async def work() -> None:
        await configure(rig, channel, max_items=10)
        await channel.put(run_of(b"x"))
        async with asyncio.timeout(PATIENCE_SECONDS):
            while hosted.channel.look(rig.now())[0].has_backlog:
                await channel.status()

    return f"configure(max_items=10) with {items:,} items, a put, and the freeing", work


async def replacement(rig: Rig, items: int) -> tuple[str, Work]:
    """The channel keeps the same number of items. So only the other objects start a garbage collection."""
    _, hosted = await opened(rig, max_items=items)
    in_order(hosted, rig, items)

    async def work() -> None:
        for _ in range(items // PUTS_PER_TURN):
            in_order(hosted, rig, PUTS_PER_TURN)
            await asyncio.sleep(0)
        more: list[object] = []
        for _ in range(MORE_OBJECTS // 1000):
            more += [[] for _ in range(1000)]
            await asyncio.sleep(0)

    return (
        f"a full channel replaces its {items:,} items, and then the process makes {MORE_OBJECTS:,} other objects",
        work,
    )


async def consumption(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig, consumers=1)
    in_order(hosted, rig, items)
    hosted.channel.consume(1, [], rig.now())

    async def work() -> None:
        request = pb.ConsumeRequest(channel_id=channel.channel_id, epoch=channel.epoch, consumer_id=1, seqs=[1])
        await rig.channels.Consume(request)
        await configure(rig, channel, max_items=10, consumers=1)

    return f"{items:,} items that a consumer has not consumed leave by max_items", work


async def first_consumers(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)

    async def work() -> None:
        await configure(rig, channel, consumers=1)
        about = {"channel_id": channel.channel_id, "epoch": channel.epoch}
        await rig.channels.Consume(pb.ConsumeRequest(consumer_id=1, seqs=[1], **about))  # type: ignore[arg-type]
        assert (await channel.status()).consumers[0].waiting == items - 1

    return f"configure(consumers=1) with {items:,} items, a consume, and a status", work


async def backwards(rig: Rig, items: int) -> tuple[str, Work]:
    """Every second item leaves. The consumers have consumed some of the other items."""
    channel, hosted = await opened(rig, consumers=10)
    now = rig.now()
    for at in range(items):
        fill(hosted, now, [now - at if at % 2 else now - 2 * items + at])
    for consumer in range(1, 11):
        hosted.channel.consume(consumer, range(2, 2 * CALLS, 2), now)

    async def work() -> None:
        await configure(rig, channel, max_items=items // 2, consumers=10)
        await channel.status()
        page = await rig.gate.ListHostedChannels(gate_pb.ListHostedChannelsRequest())
        assert len(page.channels[0].consumers) == 10

    return f"the status of 10 consumers when {items // 2:,} items left in another order than that of their seqs", work


async def deletion(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)
    calls = [rig.channels.Get() for _ in range(BLOCKED_GETS // CALLS)]
    for call in calls:
        for call_id in range(1, CALLS + 1):
            await call.write(channel.get_request(call_id, interval=channel.future(), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == BLOCKED_GETS)

    async def work() -> None:
        about = {"channel_id": channel.channel_id, "epoch": channel.epoch}
        await rig.gate.DropChannel(gate_pb.DropChannelRequest(request_id=b"0123456789abcdef", **about))  # type: ignore[arg-type]
        for call in calls:
            for _ in range(CALLS):
                assert (await call.read()).HasField("error")
        async with asyncio.timeout(PATIENCE_SECONDS):
            while len(hosted.channel.look(rig.now())[0].index):
                await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())

    return f"a channel of {items:,} items with {BLOCKED_GETS:,} blocked gets is deleted", work
