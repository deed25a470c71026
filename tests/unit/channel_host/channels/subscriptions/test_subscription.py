"""Readers of one channel, one of which stalls. There is no gRPC. The tests count turns of the event loop, not time."""

from __future__ import annotations

import asyncio
from typing import Any, cast

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.channels.subscriptions.subscription import Subscription
from stampede_rt_channel_host.cluster.records import recorded_channel

NOW = 1_700_000_000_000_000_000
READERS = 31
PUTS = 20
ENOUGH = 2**62


class Store:
    def __init__(self) -> None:
        self.scheduler = PieceScheduler()
        self.readers, self.multicasts = Readers(), None

    def now(self) -> int:
        return NOW

    def find_readable(self, channel_id: bytes, epoch: int, demand: object) -> None:
        pass


class Stream:
    """A stream to a reader that takes all messages immediately, or only the first one."""

    def __init__(self, *, stalls: bool = False) -> None:
        self.taken: list[bytes] = []
        self.offered_bytes = 0
        self._stalls = stalls

    async def read(self) -> bytes:
        await asyncio.Event().wait()
        raise AssertionError("nothing ends this wait")

    async def write(self, message: bytes) -> None:
        if self._stalls and self.taken:
            self.offered_bytes += len(message)
            await asyncio.Event().wait()
        self.taken.append(message)


async def turns_of_puts(streams: list[Stream]) -> tuple[list[int], HostedChannel]:
    """Put items. Returns for each put the turns of the event loop until all streams that do not stall have the item."""
    store = Store()
    record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(Policy(max_items=4)))
    channel = HostedChannel(recorded_channel(record), MemoryBudget(2**30), store.now, begin=store.scheduler.begin)
    tasks = [asyncio.create_task(serve(channel, store, stream)) for stream in streams]
    await turns_until(lambda: all(stream.taken for stream in streams))
    taking = [stream for stream in streams if not stream._stalls]
    turns = []
    for number in range(1, PUTS + 1):
        run = IncomingRun(encode_run([bytes(1000)], times=None), producer_id=0, first_number=0, wait_nanos=None)
        channel.puts.put(run, NOW)
        turns.append(await turns_until(lambda number=number: all(len(one.taken) == 1 + number for one in taking)))
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    return turns, channel


async def serve(channel: HostedChannel, store: Store, stream: Stream) -> None:
    task = asyncio.current_task()
    assert task is not None
    opening = pb.SubscribeRequest(open=pb.SubscribeOpen(epoch=1), credit_bytes=ENOUGH)
    await Subscription(channel, cast(Any, store), cast(Any, None), cast(Any, stream), OpenStream(task)).run(opening)


async def turns_until(condition: Any) -> int:
    for turns in range(1000):
        if condition():
            return turns
        await asyncio.sleep(0)
    raise AssertionError("the messages did not come")


async def test_a_stalled_reader_costs_the_other_readers_no_turn_of_the_event_loop() -> None:
    without, _ = await turns_of_puts([Stream() for _ in range(READERS)])
    with_stalled, channel = await turns_of_puts([Stream(stalls=True), *(Stream() for _ in range(READERS))])
    assert with_stalled[1:] == without[1:]  # the first put wakes the stalled reader for the last time
    assert channel.deliveries.encodings == PUTS


async def test_the_host_writes_one_message_more_to_a_stalled_reader() -> None:
    stalled = Stream(stalls=True)
    await turns_of_puts([stalled, Stream()])
    assert 1000 < stalled.offered_bytes < 1200
