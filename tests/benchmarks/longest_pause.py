"""How long a host's event loop stands still for one long piece of work: `python -m tests.benchmarks.longest_pause`.

One host, whose channels are filled in its own process. What a client asks for comes from a process of its own; the rest
is done as the host's shell does it. Meanwhile the loop is turned as fast as it goes. A pause is the CPU time of its
thread from one turn to the next, so that a busy machine counts for nothing; told are the longest one, and the CPU time
of the whole work. A pause of the garbage collector is one of the host, too.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import json
import random
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import grpc

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import channel_pb2, time_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_bench.tables import Table
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.channel import Offer
from stampede_rt_channel_host.core.group import CutFollower, GroupDefinition, TimesBoard
from stampede_rt_channel_host.core.queue import Enqueue, QueueCore, QueueLimits, TakerState
from stampede_rt_channel_host.core.records import RecordedGroup, ResolvedGroup
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.waiting import Waiter
from stampede_rt_channel_host.queues.frames import take_response
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, Opened, Rig, S, between, run_of, running_host

ITEMS, LATE_ITEMS, BUCKET_ITEMS = 500_000, 300_000, 50_000
BLOCKED_GETS, CALLS, CHANNELS, QUEUED_ITEMS = 10_000, 1000, 20_000, 100_000
RUN_ITEMS = 200
SUBSCRIBERS, FOLLOWED_ITEMS = 1000, 5
PAGE_ITEMS = 100
READ_ITEMS = 20_000
PATIENCE_SECONDS = 120.0

Work = Callable[[], Awaitable[None]]
Case = Callable[[Rig, int], Awaitable[tuple[str, Work]]]


class Watch:
    """Turns the loop, and notes the longest pause of its thread, in milliseconds."""

    def __init__(self) -> None:
        self.longest_ms = 0.0

    async def over(self, work: Work) -> float:
        """Do `work`; the CPU time of all, in milliseconds."""
        gc.collect()
        gc.freeze()
        task, begun = asyncio.ensure_future(work()), time.thread_time()
        last = begun
        while not task.done():
            await asyncio.sleep(0)
            now = time.thread_time()
            self.longest_ms, last = max(self.longest_ms, (now - last) * 1000), now
        await task
        gc.unfreeze()
        return (time.thread_time() - begun) * 1000


async def until(condition: Callable[[], bool]) -> None:
    """Nothing is done meanwhile but what others do."""
    while not condition():  # noqa: ASYNC110  (there is no event for it)
        await asyncio.sleep(0)


async def opened(rig: Rig, **spec: object) -> tuple[Opened, HostedChannel]:
    retention = channel_pb2.RetentionPolicy(max_age_nanos=36_000 * S, max_bytes=2**40, **spec)  # type: ignore[arg-type]
    channel = await rig.open(f"c{random.getrandbits(60)}", channel_pb2.ChannelSpec(retention=retention))
    return channel, rig.host.store.find(channel.channel_id, channel.epoch)


def fill(hosted: HostedChannel, now: int, times: Sequence[int]) -> None:
    """One run, as a put stores it."""
    run = encode_run([b"x"] * len(times), times=times)
    offer = Offer(times=times, durations=None, lengths=[1] * len(times))
    hosted.channel.put(offer, now, lambda first_seq, kept, stamped: seal_run(run, first_seq))


def in_order(hosted: HostedChannel, rig: Rig, items: int) -> None:
    now = rig.now()
    for at in range(items):
        fill(hosted, now, [now - items + at])


def interleaved(hosted: HostedChannel, rig: Rig, items: int) -> None:
    """Two producers put runs, each of whose items lies between two of the other's."""
    now = rig.now()
    for first in range(0, items, 2 * RUN_ITEMS):
        for odd in (0, 1):
            fill(hosted, now, [now - items + first + 2 * at + odd for at in range(RUN_ITEMS)])


def asked(rig: Rig, channel: Opened, verb: str) -> Work:
    """A client in a process of its own."""

    async def work() -> None:
        words = [rig.target, verb, channel.channel_id.hex(), str(channel.epoch)]
        client = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "tests.benchmarks.longest_pause", "--client", *words
        )
        async with asyncio.timeout(PATIENCE_SECONDS):
            assert await client.wait() == 0, "the client failed"

    return work


async def large_get(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    interleaved(hosted, rig, items)
    return f"get of {items:,} items of two producers that interleave, no payloads", asked(rig, channel, "get")


async def given_up_get(rig: Rig, items: int) -> tuple[str, Work]:
    """Its answer is gathered, and the reader goes when the first message of it has come."""
    channel, hosted = await opened(rig)
    interleaved(hosted, rig, items)

    async def work() -> None:
        call = rig.channels.Get()
        interval = between(MIN_INSTANT, MAX_INSTANT)
        await call.write(channel.get_request(interval=interval, without_payloads=True))
        async with asyncio.timeout(PATIENCE_SECONDS):
            await call.read()
        call.cancel()
        for _ in range(2 * items // 256):
            await asyncio.sleep(0)

    return f"the same get, given up when the first message of {items:,} items has come", work


async def subscription(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)
    return f"subscribe from the oldest of {items:,} single puts on", asked(rig, channel, "subscribe")


async def smaller_limit(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)
    retention = channel_pb2.RetentionPolicy(max_items=10)
    request = gate_pb.ConfigureChannelRequest(
        request_id=b"0123456789abcdef",
        channel_id=channel.channel_id,
        epoch=channel.epoch,
        spec=channel_pb2.ChannelSpec(retention=retention),
    )

    async def work() -> None:
        await rig.gate.ConfigureChannel(request)
        await channel.put(run_of(b"x"))
        async with asyncio.timeout(PATIENCE_SECONDS):
            while hosted.channel.look(rig.now())[0].has_backlog:
                await channel.status()

    return f"configure(max_items=10) with {items:,} items, a put, and the freeing", work


async def late_items(rig: Rig, items: int) -> tuple[str, Work]:
    _, hosted = await opened(rig)
    now = rig.now()
    fill(hosted, now, [now])
    follower = CutFollower(hosted.channel, now + 1, now)
    for at in range(items):
        fill(hosted, now, [now - 1 - at])

    async def work() -> None:
        follower.begin(now + 2)
        while follower.under_way:
            follower.take(rig.now(), 2**20)
            await asyncio.sleep(0)

    return f"a cut event with {items:,} late items", work


async def page(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    now = rig.now()
    for _ in range(items):
        fill(hosted, now, [now])
    after = {"time_unix_nano": now, "seq": items - 2 * PAGE_ITEMS}

    async def work() -> None:
        got = await channel.get(limit=PAGE_ITEMS, after=after)
        assert len(got.runs) == PAGE_ITEMS

    return f"a page of {PAGE_ITEMS} in a bucket of {items:,} equal times", work


async def reach(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    now = rig.now()
    for _ in range(items):
        fill(hosted, now, [now])
    call = rig.channels.Get()
    await call.write(channel.get_request(interval=between(now + 3600 * S, MAX_INSTANT), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == 1)

    async def work() -> None:
        for _ in range(10):
            await channel.put(run_of(b"x", times=[now]))
        call.cancel()

    return f"10 puts into a bucket of {items:,} equal times while a get is blocked", work


async def consumption(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig, consumers=1)
    in_order(hosted, rig, items)
    hosted.channel.consume(1, [], rig.now())

    async def work() -> None:
        request = pb.ConsumeRequest(channel_id=channel.channel_id, epoch=channel.epoch, consumer_id=1, seqs=[1])
        await rig.channels.Consume(request)
        retention = channel_pb2.RetentionPolicy(max_items=10, consumers=1)
        await rig.gate.ConfigureChannel(
            gate_pb.ConfigureChannelRequest(
                request_id=b"0123456789abcdef",
                channel_id=channel.channel_id,
                epoch=channel.epoch,
                spec=channel_pb2.ChannelSpec(retention=retention),
            )
        )

    return f"{items:,} items that are owed to a consumer go by count", work


async def first_consumers(rig: Rig, items: int) -> tuple[str, Work]:
    channel, hosted = await opened(rig)
    in_order(hosted, rig, items)
    retention = channel_pb2.RetentionPolicy(consumers=1)
    request = gate_pb.ConfigureChannelRequest(
        request_id=b"0123456789abcdef",
        channel_id=channel.channel_id,
        epoch=channel.epoch,
        spec=channel_pb2.ChannelSpec(retention=retention),
    )

    async def work() -> None:
        await rig.gate.ConfigureChannel(request)
        about = {"channel_id": channel.channel_id, "epoch": channel.epoch}
        await rig.channels.Consume(pb.ConsumeRequest(consumer_id=1, seqs=[1], **about))  # type: ignore[arg-type]
        assert (await channel.status()).consumers[0].waiting == items - 1

    return f"configure(consumers=1) with {items:,} items, a consume, and a status", work


async def backwards(rig: Rig, items: int) -> tuple[str, Work]:
    """What goes first came last; each other one of the items is consumed, too."""
    channel, hosted = await opened(rig, consumers=10)
    now = rig.now()
    for at in range(items):
        fill(hosted, now, [now - at if at % 2 else now - 2 * items + at])
    for consumer in range(1, 11):
        hosted.channel.consume(consumer, range(2, 2 * CALLS, 2), now)

    async def work() -> None:
        retention = channel_pb2.RetentionPolicy(max_items=items // 2, consumers=10)
        await rig.gate.ConfigureChannel(
            gate_pb.ConfigureChannelRequest(
                request_id=b"0123456789abcdef",
                channel_id=channel.channel_id,
                epoch=channel.epoch,
                spec=channel_pb2.ChannelSpec(retention=retention),
            )
        )
        await channel.status()
        page = await rig.gate.ListHostedChannels(gate_pb.ListHostedChannelsRequest())
        assert len(page.channels[0].consumers) == 10

    return f"the status of 10 consumers when {items // 2:,} items went out of the order of seqs", work


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


async def release(rig: Rig, gets: int) -> tuple[str, Work]:
    """All of them wait for the next item."""
    channel, _ = await opened(rig)
    calls = [rig.channels.Get() for _ in range(max(1, gets // CALLS))]
    for call in calls:
        for call_id in range(1, CALLS + 1):
            await call.write(channel.get_request(call_id, interval=between(rig.now(), MAX_INSTANT), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == len(calls) * CALLS)

    async def read(call: Any) -> None:
        answered = 0
        while answered < CALLS:
            answered += (await call.read()).HasField("summary")

    async def work() -> None:
        await channel.put(run_of(b"x"))
        async with asyncio.timeout(PATIENCE_SECONDS):
            await asyncio.gather(*map(read, calls))

    return f"a put that releases {len(calls) * CALLS:,} blocked gets", work


async def listing(rig: Rig, channels: int) -> tuple[str, Work]:
    for number in range(channels):
        await rig.open(f"c/{number:06}", channel_pb2.ChannelSpec())

    async def work() -> None:
        page = await rig.gate.ListHostedChannels(gate_pb.ListHostedChannelsRequest())
        assert len(page.channels) == min(channels, 1000)

    return f"a page of 1000 of {channels:,} channels", work


async def subscribers(rig: Rig, count: int) -> tuple[str, Work]:
    """Each of them has a message sent."""
    channel, hosted = await opened(rig)
    client = asyncio.create_task(asked(rig, channel, "follow")())  # type: ignore[arg-type]
    async with asyncio.timeout(PATIENCE_SECONDS):
        await until(lambda: len(hosted.listeners) == count)

    async def work() -> None:
        for _ in range(FOLLOWED_ITEMS):
            await channel.put(run_of(b"x"))
        await client

    return f"{FOLLOWED_ITEMS} puts to a channel with {count:,} subscriptions", work


async def group_readers(rig: Rig, count: int) -> tuple[str, Work]:
    """As subscriptions to cuts wait for a group, which moves, and then goes."""
    hosted = group_of(rig)
    heard = 0

    async def wait(waiter: Waiter) -> None:
        nonlocal heard
        for _ in range(2):
            with contextlib.suppress(StampedeError):
                await waiter.wait(None)
            heard += 1

    waiters = [Waiter() for _ in range(count)]
    waiting = [asyncio.create_task(wait(one)) for one in waiters]
    for one in waiters:
        hosted.listeners.add(one)
    await asyncio.sleep(0)  # they wait

    async def work() -> None:
        hosted.arrangement += 1
        hosted.changed()
        await until(lambda: heard == count)
        hosted.end(Unavailable("gone"))
        await until(lambda: heard == count + len(waiting))

    return f"a group with {count:,} readers moves, and ends", work


def group_of(rig: Rig) -> HostedGroup:
    group = RecordedGroup(group_id=b"g" * 16, name="g", definition=GroupDefinition(members=frozenset()), message=b"")
    told = ResolvedGroup(group=group, channels={}, targets={}, host_names={})
    begin = rig.host.store.scheduler.begin
    return HostedGroup(told, TimesBoard(), rig.now, on_moved=lambda _: None, on_idle=lambda _: None, begin=begin)


async def batches(rig: Rig, items: int) -> tuple[str, Work]:
    """The core alone, as its shell moves it: `tick` when it is due."""
    queue = QueueCore(QueueLimits(max_items=items, max_bytes=2**40), incarnation=1)
    takers = [TakerState(taker_id, None) for taker_id in range(1, 101)]
    for _ in range(items):
        queue.enqueue(Enqueue([1], lambda first_seq, places, stamped: b"x" * 24), rig.now())

    async def work() -> None:
        for taker in takers:
            queue.grant(taker, items // len(takers), rig.now())
            await asyncio.sleep(0)
        taken = 0
        while taken < items:
            for taker, batch in queue.take_dealt():
                queue.sending(taker)
                take_response(batch, (), rig.now())
                taken += sum(one.hi - one.lo for one in batch.slices)
                await asyncio.sleep(0)
                queue.sent(taker, rig.now())
            queue.tick(rig.now())
            await asyncio.sleep(0)

    return f"{items:,} single queued items are dealt to 100 takers", work


CASES: dict[str, tuple[Case, int]] = {
    "get": (large_get, ITEMS),
    "given-up": (given_up_get, ITEMS),
    "subscribe": (subscription, ITEMS),
    "configure": (smaller_limit, ITEMS),
    "late": (late_items, LATE_ITEMS),
    "page": (page, BUCKET_ITEMS),
    "reach": (reach, BUCKET_ITEMS),
    "consumption": (consumption, ITEMS),
    "first-consumers": (first_consumers, ITEMS),
    "backwards": (backwards, 2 * CHANNELS * 10),
    "delete": (deletion, ITEMS),
    "release": (release, BLOCKED_GETS),
    "list": (listing, CHANNELS),
    "batches": (batches, QUEUED_ITEMS),
    "subscribers": (subscribers, SUBSCRIBERS),
    "group-readers": (group_readers, 4096),
}


def ask(target: str, verb: str, channel_id: str, epoch: str) -> None:
    """As a client does: one get, or the first items of a subscription."""
    with grpc.insecure_channel(target, options=[("grpc.max_receive_message_length", -1)]) as connection:
        stub = ChannelServiceStub(connection)
        about = {"channel_id": bytes.fromhex(channel_id), "epoch": int(epoch)}
        oldest = time_pb2.Bound(instant_unix_nano=MIN_INSTANT)
        if verb == "get":
            interval = between(MIN_INSTANT, MAX_INSTANT)
            get = pb.GetRequest(call_id=1, interval=interval, without_payloads=True, **about)  # type: ignore[arg-type]
            assert [*stub.Get(iter((get,)))][-1].HasField("summary")
            return
        if verb == "follow":
            asyncio.run(follow(target, pb.SubscribeOpen(**about)))  # type: ignore[arg-type]
            return
        begun = pb.SubscribeOpen(start=oldest, **about)  # type: ignore[arg-type]
        items = 0
        for response in stub.Subscribe(iter((pb.SubscribeRequest(open=begun, credit_bytes=2**60),))):
            items += sum(len(one.run.payload_length_bytes) for one in response.runs)
            if items >= READ_ITEMS:
                return


async def follow(target: str, begun: pb.SubscribeOpen) -> None:
    """Many subscriptions, each of which takes a few items."""

    async def one(connection: grpc.aio.Channel) -> None:
        items = 0
        call = ChannelServiceStub(connection).Subscribe(iter((pb.SubscribeRequest(open=begun, credit_bytes=2**60),)))
        async for response in call:
            items += sum(len(one.run.payload_length_bytes) for one in response.runs)
            if items >= FOLLOWED_ITEMS:
                return

    options = [("grpc.use_local_subchannel_pool", 1)]
    connections = [grpc.aio.insecure_channel(target, options=options) for _ in range(20)]
    await asyncio.gather(*(one(connections[at % 20]) for at in range(SUBSCRIBERS)))
    for connection in connections:
        await connection.close()


async def measure(names: Sequence[str], share: float) -> None:
    """One host for each case, so that none leaves the next one anything."""
    gc.set_threshold(5_000, 5, 1_000)  # as `stampede host` does
    table = Table(("longest pause, ms", "all, ms", "work"))
    for name in names:
        case, items = CASES[name]
        async with running_host(memory_bytes_max=2**40) as rig:
            text, work = await case(rig, int(items * share))
            watch = Watch()
            all_ms = await watch.over(work)
            table.rows.append((f"{watch.longest_ms:,.1f}", f"{all_ms:,.0f}", text))
            print(json.dumps({"case": name, "longest_ms": watch.longest_ms, "all_ms": all_ms}), file=sys.stderr)
    table.print()


def main() -> None:
    """Measure and print; with --client be the client."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; none: all")
    parser.add_argument("--share", type=float, default=1.0, help="of the items")
    parser.add_argument("--client", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.client:
        ask(*options.client)
    else:
        asyncio.run(measure(options.cases or [*CASES], options.share))


if __name__ == "__main__":
    main()
