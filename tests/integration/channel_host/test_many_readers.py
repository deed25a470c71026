"""Many readers of one channel: a host encodes a message once for all, and keeps little for a stalled reader."""

from __future__ import annotations

import asyncio
import tracemalloc
from collections.abc import AsyncIterator, Sequence
from typing import Any

import pytest

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.frames import SHARED_BYTES_MAX
from tests.support.channel_host.rig import OpenedChannel, Rig, instant, payloads_of, run_of, running_host
from tests.support.waiting import until

READERS = 32
HELD_BYTES_MAX = 16 * 2**20


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def readers_of(channel: OpenedChannel, count: int, **fields: Any) -> list[Any]:
    calls = [channel.subscribe(**fields) for _ in range(count)]
    for call in calls:
        assert (await call.read()).HasField("opened")
    return calls


async def next_payloads(call: Any) -> list[bytes]:
    """The payloads of the next message that has items."""
    async with asyncio.timeout(20):
        while not (runs := (await call.read()).runs):
            pass
    return [payload for delivered in runs for payload in payloads_of(delivered.run)]


def bytes_of_host() -> int:
    """The traced bytes that the host's own code has allocated. The readers are in the same process."""
    host = [tracemalloc.Filter(True, f"*/{name}/*") for name in ("stampede_rt_channel_host", "stampede_rt/wire")]
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces(host).traces)


async def put_and_read(channel: OpenedChannel, calls: Sequence[Any], payload: bytes, number: int) -> None:
    await channel.put(run_of(payload, number=number))
    for found in await asyncio.gather(*map(next_payloads, calls)):
        assert found == [payload]


@pytest.mark.parametrize("fields", [{}, {"mode": pb.SUBSCRIBE_MODE_NEWEST}, {"without_payloads": True}])
async def test_a_host_encodes_a_message_once_for_32_readers(rig: Rig, fields: dict[str, Any]) -> None:
    channel = await rig.open()
    calls = await readers_of(channel, READERS, **fields)
    deliveries = rig.host.store.deliveries
    for number in range(1, 6):
        payload = b"" if "without_payloads" in fields else b"%d" % number
        await put_and_read(channel, calls, payload, number)
        assert deliveries.encodings == number
        assert deliveries.kept_bytes == 0


async def test_readers_without_payloads_and_readers_at_other_positions_get_their_own_messages(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(run_of(b"held"))
    plain = await readers_of(channel, 4)
    bare = await readers_of(channel, 4, without_payloads=True)
    late = channel.subscribe(start=instant(0))
    await channel.put(run_of(b"new", number=2))
    assert [await next_payloads(call) for call in plain] == [[b"new"]] * 4
    assert [await next_payloads(call) for call in bare] == [[b""]] * 4
    found: list[bytes] = []
    while len(found) < 2:
        found += await next_payloads(late)
    assert found == [b"held", b"new"]


async def test_a_stalled_reader_of_32_keeps_less_than_16_mib_of_the_host(rig: Rig) -> None:
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=4)))
    (stalled,) = await readers_of(channel, 1)  # the reader has granted all its credit, and reads nothing more
    others = await readers_of(channel, READERS - 1)
    puts, size = 36, 2**19
    hosted = rig.host.store.find(channel.channel_id, channel.epoch)
    tracemalloc.start()
    try:
        for number in range(1, puts + 1):
            await put_and_read(channel, others, number.to_bytes(2, "big") * (size // 2), number)
        held_bytes = bytes_of_host()
    finally:
        tracemalloc.stop()
    # the channel's items, kept messages, and the message that is being written
    assert size < held_bytes < HELD_BYTES_MAX
    read_bytes = (READERS - 1) * puts * size
    await until(lambda: hosted.delivered_bytes >= read_bytes)  # the host counts a message after its write
    assert hosted.delivered_bytes - read_bytes < HELD_BYTES_MAX  # at most these bytes are in gRPC's buffers
    assert rig.host.store.deliveries.kept_bytes <= SHARED_BYTES_MAX
    stalled.cancel()
