"""Work for many readers, items or channels is done in pieces. Between two pieces the host serves other callers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from itertools import pairwise
from typing import Any

import grpc
import pytest

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels import channel_table
from stampede_rt_channel_host.channels.channel_table import CHANNELS_COMPARED_PER_PIECE
from stampede_rt_channel_host.channels.gets.waiting_gets import GETS_PER_PIECE
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.listing import NAMES_PER_PIECE, STATUSES_PER_PIECE, page_of
from stampede_rt_channel_host.channels.observers import OBSERVERS_PER_PIECE
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.puts.ack_writer import RUNS_PER_TURN
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.puts import ITEMS_OFFERED_MAX, PUTS_PER_PIECE
from stampede_rt_channel_host.channels.store import CHANNELS_ENDED_PER_PIECE, ChannelStore
from stampede_rt_channel_host.channels.subscriptions import subscription
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.core.records import RecordedChannel
from tests.support.channel_host.queue_rig import run_of as queue_run_of
from tests.support.channel_host.queue_rig import running_queue_host
from tests.support.channel_host.rig import HOST_ID, OpenedChannel, Rig, run_of, running_host

REQUEST_ID = b"0123456789abcdef"


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def blocked(rig: Rig, channel: OpenedChannel, gets: int) -> object:
    call = rig.channels.Get()
    for call_id in range(1, gets + 1):
        await call.write(channel.get_request(call_id, interval=channel.future(), wait_nanos=-1))
    await channel.until(lambda status: status.waiting_gets == gets)
    return call


async def test_blocked_gets_are_ended_in_pieces(rig: Rig) -> None:
    channel = await rig.open()
    call = await blocked(rig, channel, 5 * GETS_PER_PIECE)
    hosted = rig.host.store.find(channel.channel_id, channel.epoch)
    left = []
    for _ in hosted.ending(Unavailable("gone")):
        left.append(len(hosted.gets))
    assert left == [GETS_PER_PIECE * pieces for pieces in range(4, 0, -1)]
    assert not hosted.gets, "the last piece ends the work"
    for _ in range(5 * GETS_PER_PIECE):
        response: pb.GetResponse = await call.read()  # type: ignore[attr-defined]
        assert response.error.message == "gone"


async def test_each_waiting_caller_of_a_deleted_channel_gets_an_error_and_its_items_are_freed(rig: Rig) -> None:
    channel = await rig.open()
    hosted = rig.host.store.find(channel.channel_id, channel.epoch)
    await channel.put(*(run_of(b"x", number=number) for number in range(1, 2001)))
    call = await blocked(rig, channel, 3 * GETS_PER_PIECE)
    drop = gate_pb.DropChannelRequest(request_id=REQUEST_ID, channel_id=channel.channel_id, epoch=channel.epoch)
    await rig.gate.DropChannel(drop)
    for _ in range(3 * GETS_PER_PIECE):
        response: pb.GetResponse = await call.read()  # type: ignore[attr-defined]
        assert response.HasField("error")
    held, _ = hosted.channel.look(rig.now())
    async with asyncio.timeout(45):
        while len(held.index):
            await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())


async def test_a_listing_looks_at_a_bounded_number_of_channels_in_one_piece(rig: Rig) -> None:
    store, names = rig.host.store, [f"c/{number:04}" for number in range(4 * NAMES_PER_PIECE)]
    for number, name in enumerate(names):
        spec = channel_pb2.ChannelSpec()
        record = channel_pb2.ChannelRecord(
            channel_id=number.to_bytes(16, "big"), name=name, incarnation=1, epoch=1, host_id=HOST_ID, spec=spec
        )
        store.adopt(recorded_channel(record))
    every = page_of(store, lambda name: True, "", 10 * STATUSES_PER_PIECE)
    assert sum(1 for _ in every) == 11  # 10 pieces of 32 statuses, and one piece for the first 256 names
    none = page_of(store, lambda name: False, "", 10)
    assert sum(1 for _ in none) == 4
    page = await PieceScheduler().do(page_of(store, lambda name: name.endswith("7"), names[100], 3))
    assert [one.record.name for one in page.channels] == ["c/0107", "c/0117", "c/0127"]
    assert page.has_more


async def test_a_piece_without_a_waiting_caller_runs_after_the_others() -> None:
    done: list[int] = []

    def three() -> Pieces[None]:
        for number in range(3):
            done.append(number)
            yield

    PieceScheduler().begin(three())
    assert done == [0]
    for _ in range(10):
        await asyncio.sleep(0)
    assert done == [0, 1, 2]


def a_run(number: int) -> IncomingRun:
    return IncomingRun(encode_run([b"x"], times=None), producer_id=7, first_number=number, wait_nanos=None)


async def full(rig: Rig, waiting: int) -> tuple[HostedChannel, list[IncomingRun]]:
    """A channel that holds one item, while `waiting` runs wait for room."""
    retention = channel_pb2.RetentionPolicy(max_items=1, max_age_nanos=3600 * 10**9)
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=retention, on_full=channel_pb2.ON_FULL_BLOCK))
    hosted = rig.host.store.find(channel.channel_id, channel.epoch)
    runs = [a_run(number) for number in range(1, waiting + 2)]
    assert [hosted.puts.put(run, rig.now()) is None for run in runs] == [False] + [True] * waiting
    return hosted, runs[1:]


async def test_waiting_puts_are_refused_in_pieces_and_in_order_and_none_of_them_is_accepted(rig: Rig) -> None:
    hosted, runs = await full(rig, 4 * PUTS_PER_PIECE)
    left = []
    for _ in hosted.ending(Unavailable("gone", reason="NOT_HERE")):
        left.append(len(hosted.puts))
        repeated = hosted.puts.put(a_run(len(runs)), rig.now())  # repeats a run that still waits
        assert repeated is not None
        assert repeated.error.message == "gone"
        hosted.channel.configure(Policy(max_items=10**6, on_full="block", max_age_nanos=3600 * 10**9), rig.now())
        hosted.puts.changed(rig.now())  # there is room now, and no put waits for it
        assert [run.ack is not None for run in runs] == [True] * (len(runs) - left[-1]) + [False] * left[-1]
    assert left == [PUTS_PER_PIECE * pieces for pieces in (3, 2, 1)]
    assert {run.ack.error.message for run in runs if run.ack is not None} == {"gone"}
    assert hosted.channel.counters(rig.now()).held == 1
    ack = hosted.puts.put(a_run(len(runs)), rig.now())  # the host has its lease again
    assert ack is not None
    assert ack.first_seq == 2


async def test_a_waiting_put_gets_room_when_the_lease_is_held_again(rig: Rig) -> None:
    hosted, (run,) = await full(rig, 1)
    hosted.puts._may_serve = lambda: False
    hosted.channel.configure(Policy(max_items=10, on_full="block", max_age_nanos=3600 * 10**9), rig.now())
    hosted.puts.changed(rig.now())
    assert run.ack is None
    hosted.puts._may_serve = lambda: True
    hosted.puts.changed(rig.now())
    assert run.ack is not None


async def test_room_for_many_puts_that_wait_is_given_to_some_at_a_time_in_their_order(rig: Rig) -> None:
    hosted, runs = await full(rig, 3 * ITEMS_OFFERED_MAX)
    hosted.channel.configure(Policy(max_items=10**6, on_full="block", max_age_nanos=3600 * 10**9), rig.now())
    hosted.puts.changed(rig.now())
    assert [run.ack is not None for run in runs] == [True] * ITEMS_OFFERED_MAX + [False] * 2 * ITEMS_OFFERED_MAX
    async with asyncio.timeout(45):
        while len(hosted.puts):
            await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())
    assert [run.ack.first_seq for run in runs if run.ack is not None] == [*range(2, len(runs) + 2)]


async def test_subscriptions_are_ended_in_pieces(rig: Rig) -> None:
    channel = await rig.open()
    hosted = rig.host.store.find(channel.channel_id, channel.epoch)
    ended: list[StampedeError] = []

    class Reader:
        def wake(self) -> None: ...

        def end(self, error: StampedeError) -> None:
            ended.append(error)

    for _ in range(3 * OBSERVERS_PER_PIECE):
        hosted.subscriptions.add(Reader())
    counts = [len(ended) for _ in hosted.ending(Unavailable("gone"))]
    assert counts == [OBSERVERS_PER_PIECE * pieces for pieces in (1, 2)]
    assert len(ended) == 3 * OBSERVERS_PER_PIECE


def adopt(store: ChannelStore, channels: int) -> list[RecordedChannel]:
    """Serve channels without asking the directory."""
    records = [
        recorded_channel(
            channel_pb2.ChannelRecord(
                channel_id=number.to_bytes(16, "big"), name=f"c/{number}", incarnation=1, epoch=1, host_id=HOST_ID
            )
        )
        for number in range(channels)
    ]
    for record in records:
        store.adopt(record)
    return records


async def test_a_registration_looks_at_a_bounded_number_of_channels_in_one_piece(rig: Rig) -> None:
    store = rig.host.store
    records = adopt(store, 8 * CHANNELS_COMPARED_PER_PIECE)
    late = channel_pb2.ChannelRecord(channel_id=b"l" * 16, name="late", incarnation=1, epoch=1, host_id=HOST_ID)
    left = []
    for at, _ in enumerate(store.registering(records[:10], is_complete=True)):
        left.append(len(store.all()))
        if at == 0:
            store.adopt(recorded_channel(late))  # the directory has named this channel since the registration
    assert max(before - after for before, after in pairwise(left)) <= CHANNELS_COMPARED_PER_PIECE
    assert {hosted.record.name for hosted in store.all()} == {"late", *(f"c/{number}" for number in range(10))}
    assert len(store.scheduler._tasks) <= 8


async def test_a_lost_lease_ends_a_bounded_number_of_channels_in_one_piece_and_lists_no_other_channels(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = rig.host.store
    adopt(store, 4 * CHANNELS_ENDED_PER_PIECE)
    ended: list[HostedChannel] = []

    def ending(hosted: HostedChannel, error: StampedeError) -> Pieces[None]:
        ended.append(hosted)
        yield from ()

    monkeypatch.setattr(HostedChannel, "ending", ending)
    monkeypatch.setattr(ChannelStore, "all", None)
    store.fence()
    assert len(ended) == CHANNELS_ENDED_PER_PIECE
    async with asyncio.timeout(45):
        while store.scheduler._tasks:
            await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())
    assert len({*ended}) == len(ended) == 4 * CHANNELS_ENDED_PER_PIECE


async def test_refused_subscriptions_and_binds_are_counted_and_other_errors_are_not(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = await rig.open()

    async def refused_calls() -> tuple[int, bool]:
        ping = await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())
        return ping.refused_calls, ping.HasField("refused_call_ago_nanos")

    with pytest.raises(grpc.aio.AioRpcError):
        await channel.subscribe(epoch=channel.epoch + 1).read()
    assert await refused_calls() == (0, False)
    monkeypatch.setattr(subscription, "SUBSCRIPTIONS_MAX", 0)
    with pytest.raises(grpc.aio.AioRpcError, match="the limit"):
        await channel.subscribe().read()
    monkeypatch.setattr(channel_table, "CHANNELS_MAX", 1)
    with pytest.raises(grpc.aio.AioRpcError, match="the limit"):
        await rig.open("b")
    assert await refused_calls() == (2, True)


class Turns:
    """Counts the calls of a function in each turn of the event loop."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
        self.counts = [0]
        self._call = getattr(owner, name)
        monkeypatch.setattr(owner, name, self._counted)
        self._turns = asyncio.create_task(self._count_turns())

    def _counted(self, *arguments: Any) -> Any:
        self.counts[-1] += 1
        return self._call(*arguments)

    async def _count_turns(self) -> None:
        while True:  # ends with the test
            self.counts.append(0)
            await asyncio.sleep(0)

    def end(self) -> list[int]:
        self._turns.cancel()
        return self.counts


async def test_a_few_runs_of_a_large_request_of_puts_are_judged_in_each_turn(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = await rig.open()
    turns = Turns(monkeypatch, rig.host.store.find(channel.channel_id, channel.epoch).puts, "put")
    acks = await channel.put(*(run_of(b"x", number=number) for number in range(1, 101)))
    assert [ack.first_seq for ack in acks] == [*range(1, 101)]
    counts = turns.end()
    assert (sum(counts), max(counts)) == (100, RUNS_PER_TURN)


async def test_a_few_runs_of_a_large_request_of_messages_are_judged_in_each_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with running_queue_host() as rig:
        queue = rig.open()
        await queue.put(b"first")
        turns = Turns(monkeypatch, rig.host.queues.find(queue.queue_id, queue.record.epoch).queue, "enqueue")
        acks = await queue.enqueue(*(queue_run_of(b"x", number=number) for number in range(1, 101)))
        counts = turns.end()
    assert [ack.first_seq for ack in acks] == [*range(2, 102)]
    assert (sum(counts), max(counts)) == (100, RUNS_PER_TURN)
