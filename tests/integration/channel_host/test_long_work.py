"""Long work of a channel host in pieces. Between two pieces the host serves all other callers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from stampede_rt.v1 import channel_pb2, error_pb2, time_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.holdings import Holdings
from tests.support.channel_host.rig import FOREVER, MIN_INSTANT, OpenedChannel, Rig, S, between, run_of, running_host

ITEMS = 400


@pytest.fixture
async def rig(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Rig]:
    monkeypatch.setattr(pieces, "STEPS_PER_PIECE", 8)
    async with running_host() as rig:
        yield rig


class LargeChannel:
    """A channel with 400 items of two producers that interleave: each item is a slice of its own."""

    def __init__(self, channel: OpenedChannel) -> None:
        self.channel = channel
        self.rig = channel.rig
        self.start = channel.rig.now() - 10 * S

    async def fill(self) -> LargeChannel:
        for odd in (0, 1):
            times = [self.start + 2 * at + odd for at in range(ITEMS // 2)]
            await self.channel.put(run_of(*[b"x"] * len(times), times=times))
        return self

    @property
    def held(self) -> Holdings:
        hosted = self.rig.host.store.find(self.channel.channel_id, self.channel.epoch)
        return hosted.channel.look(self.rig.now())[0]

    @property
    def times(self) -> list[int]:
        return [self.start + at for at in range(ITEMS)]

    async def until(self, *, begun: bool) -> None:
        """Wait until long work in the channel is under way, or until no long work is under way."""
        async with asyncio.timeout(45):
            while bool(self.held._snapshots) is not begun:
                await self.rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())


async def large(rig: Rig) -> LargeChannel:
    spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_age_nanos=600 * S))
    return await LargeChannel(await rig.open("large", spec)).fill()


async def test_a_large_get_does_not_delay_other_calls_and_shows_the_channel_as_it_was_at_the_start(rig: Rig) -> None:
    one, other = await large(rig), await rig.open("other")
    async with rig.host.store.scheduler._turn:  # as if other long work had its turn
        getting = asyncio.create_task(one.channel.get(without_payloads=True))
        await one.until(begun=True)
        assert (await other.put(run_of(b"beside")))[0].first_seq == 1
        assert (await other.get()).payloads == [b"beside"]
        await one.channel.put(run_of(b"since", times=[one.start + 1]))
    got = await getting
    assert got.times == one.times
    assert not one.held._snapshots


async def test_a_large_answer_of_a_waiting_get_is_built_in_pieces(rig: Rig) -> None:
    one = await large(rig)
    end = rig.now() + S // 2
    interval = between(MIN_INSTANT, end)
    getting = asyncio.create_task(one.channel.get(interval=interval, complete=True, wait_nanos=FOREVER))
    await one.channel.until(lambda status: status.waiting_gets == 1)
    async with rig.host.store.scheduler._turn:
        await one.channel.put(run_of(b"ends it", times=[end + 1]))
        await one.until(begun=True)
        assert (await one.channel.status()).waiting_gets == 0
    assert (await getting).times[:ITEMS] == one.times


async def test_a_cancelled_large_get_keeps_no_item_from_collection(rig: Rig) -> None:
    one = await large(rig)
    call = rig.channels.Get()
    async with rig.host.store.scheduler._turn:
        await call.write(one.channel.get_request(1))
        await one.until(begun=True)
        await call.write(pb.GetRequest(call_id=1, cancel=True))
        await one.until(begun=False)
    await call.write(one.channel.newest_request(1))
    response: Any = await call.read()
    assert (response.call_id, len(response.runs)) == (1, 1)
    call.cancel()


async def test_a_large_get_fails_if_its_channel_is_deleted_meanwhile(rig: Rig) -> None:
    one = await large(rig)
    async with rig.host.store.scheduler._turn:
        getting = asyncio.create_task(one.channel.get())
        await one.until(begun=True)
        held = one.held
        request = gate_pb.DropChannelRequest(
            request_id=b"0123456789abcdef", channel_id=one.channel.channel_id, epoch=one.channel.epoch
        )
        await rig.gate.DropChannel(request)
    assert (await getting).error.reason == error_pb2.ERROR_REASON_NOT_HERE
    assert not held._snapshots


async def test_a_subscription_with_many_held_items_begins_in_pieces(rig: Rig) -> None:
    one = await large(rig)
    async with rig.host.store.scheduler._turn:
        call = one.channel.subscribe(start=time_pb2.Bound(instant_unix_nano=MIN_INSTANT))
        reading = asyncio.create_task(call.read())
        await one.until(begun=True)
        await one.channel.put(run_of(b"since", times=[one.start + 1]))
    assert (await reading).HasField("opened")
    times: list[int] = []
    async with asyncio.timeout(45):
        while len(times) <= ITEMS:
            times += [time for delivered in (await call.read()).runs for time in delivered.run.time_unix_nano]
    assert sorted(times) == sorted([*one.times, one.start + 1])
    call.cancel()
