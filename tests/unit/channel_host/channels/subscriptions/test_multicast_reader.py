"""A subscription whose reader asks for items that no datagram brought, without gRPC and without a network."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, cast

from stampede_rt.v1 import channel_pb2, error_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.multicast.multicasts import Multicasts
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.channels.subscriptions.subscription import Subscription
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import FormerIncarnation, Losses

NOW = 1_700_000_000_000_000_000


class Group:
    address = "239.1.2.3:7000"

    async def send(self, datagrams: object) -> None:
        pass


class Store:
    def __init__(self) -> None:
        self.scheduler, self.readers = PieceScheduler(), Readers()
        self.multicasts = Multicasts(cast(Any, Group()), self.now)

    def now(self) -> int:
        return NOW

    def find_readable(self, channel_id: bytes, epoch: int, demand: object) -> None:
        pass


class Reader:
    """The far end of the stream. It takes all messages immediately."""

    def __init__(self) -> None:
        self.requests = asyncio.Queue[bytes]()
        self.taken = list[pb.SubscribeResponse]()
        self.read = self.requests.get

    async def write(self, message: bytes) -> None:
        self.taken.append(pb.SubscribeResponse.FromString(message))

    def ask(self, next_seq: int) -> None:
        request = pb.SubscribeRequest(repair_next_seq=next_seq, credit_bytes=1)
        self.requests.put_nowait(request.SerializeToString())

    async def answer(self) -> pb.SubscribeResponse:
        await self.until(lambda: self.taken[-1].HasField("repair_next_seq"))
        return self.taken[-1]

    async def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(1000):
            if condition():
                return
            await asyncio.sleep(0)
        raise AssertionError("the host does not answer")


def channel_of(store: Store) -> HostedChannel:
    """A channel with the items 1 and 2, whose later items were lost with a former host."""
    record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(Policy(max_items=4)))
    hosted = HostedChannel(recorded_channel(record), MemoryBudget(2**30), store.now, begin=store.scheduler.begin)
    run = IncomingRun(encode_run([b"1", b"2"], times=None), producer_id=0, first_number=0, wait_nanos=None)
    hosted.puts.put(run, NOW)
    hosted.core.take_losses(Losses(NOW, None, (FormerIncarnation(4, 3),)))
    return hosted


@asynccontextmanager
async def reading(
    incarnation: int, credit: int, begin: Callable[[Subscription, Reader], None]
) -> AsyncIterator[Reader]:
    """A reader that has the items 1 and 2, and an offer."""
    store, reader = Store(), Reader()
    hosted = channel_of(store)
    cursor = pb.SubscriptionCursor(incarnation=incarnation, next_seq=3)
    opening = pb.SubscribeOpen(epoch=1, mode=pb.SUBSCRIBE_MODE_ALL, cursor=cursor, multicast=True)

    async def serve() -> None:
        task = asyncio.current_task()
        assert task is not None
        served = Subscription(hosted, cast(Any, store), cast(Any, None), cast(Any, reader), OpenStream(task))
        begin(served, reader)
        await served.run(pb.SubscribeRequest(open=opening, credit_bytes=credit))

    task = asyncio.create_task(serve())
    await reader.until(lambda: bool(reader.taken))
    assert reader.taken[0].multicast.stream_id
    yield reader
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_a_reader_that_asks_early_still_learns_of_a_loss() -> None:
    async with reading(incarnation=4, credit=0, begin=lambda served, reader: None) as reader:
        reader.ask(3)
        answer = await reader.answer()
        assert answer.gap.reason == error_pb2.ABSENCE_REASON_LOST
        assert (answer.repair_next_seq, answer.cursor.incarnation) == (3, 5)


async def test_a_request_that_arrives_while_the_host_waits_for_its_turn_is_answered_immediately() -> None:
    class Work:
        must_wait = True

        def __init__(self, reader: Reader) -> None:
            self._reader = reader

        async def turn(self) -> None:
            self.must_wait = False
            self._reader.ask(3)
            for _ in range(9):  # the host reads the request meanwhile
                await asyncio.sleep(0)

    def begin(served: Subscription, reader: Reader) -> None:
        served._work = cast(Any, Work(reader))

    async with reading(incarnation=5, credit=1000, begin=begin) as reader:
        assert (await reader.answer()).repair_next_seq == 3
