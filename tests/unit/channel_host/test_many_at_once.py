"""What concerns many readers, items or channels is done in pieces, between which others are served."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt_channel_host.channels.listing import NAMES_PER_PIECE, STATUSES_PER_PIECE, page_of
from stampede_rt_channel_host.channels.turns import Turns
from stampede_rt_channel_host.channels.waiting_gets import GETS_PER_PIECE
from stampede_rt_channel_host.core.channel import Pieces
from tests.unit.channel_host.rig import HOST_ID, Opened, Rig, run_of, running_host

REQUEST_ID = b"0123456789abcdef"


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def blocked(rig: Rig, channel: Opened, gets: int) -> object:
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
    assert left == [GETS_PER_PIECE * pieces for pieces in range(4, -1, -1)]
    for _ in range(5 * GETS_PER_PIECE):
        response: pb.GetResponse = await call.read()  # type: ignore[attr-defined]
        assert response.error.message == "gone"


async def test_all_who_wait_for_a_channel_that_is_deleted_are_told_and_its_items_are_let_go(rig: Rig) -> None:
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
    async with asyncio.timeout(10):
        while len(held.index):
            await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())


async def test_a_listing_looks_at_a_bounded_number_of_channels_in_one_piece(rig: Rig) -> None:
    store, names = rig.host.store, [f"c/{number:04}" for number in range(4 * NAMES_PER_PIECE)]
    for number, name in enumerate(names):
        spec = channel_pb2.ChannelSpec()
        record = channel_pb2.ChannelRecord(
            channel_id=number.to_bytes(16, "big"), name=name, incarnation=1, epoch=1, host_id=HOST_ID, spec=spec
        )
        store._adopt(record)
    every = page_of(store, lambda name: True, "", 10 * STATUSES_PER_PIECE)
    assert sum(1 for _ in every) == 11  # one for each 32 of 320, and one for the names of the first 256
    none = page_of(store, lambda name: False, "", 10)
    assert sum(1 for _ in none) == 4
    page = await Turns().do(page_of(store, lambda name: name.endswith("7"), names[100], 3))
    assert [one.record.name for one in page.channels] == ["c/0107", "c/0117", "c/0127"]
    assert page.has_more


async def test_a_piece_that_nobody_waits_for_gives_way_to_others() -> None:
    done: list[int] = []

    def three() -> Pieces[None]:
        for number in range(3):
            done.append(number)
            yield

    Turns().begin(three())
    assert done == [0]
    for _ in range(10):
        await asyncio.sleep(0)
    assert done == [0, 1, 2]
