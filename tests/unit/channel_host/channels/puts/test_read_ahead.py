"""While a put waits, the host reads further requests of the stream. They count as memory of the host."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

from grpc.aio import EOF

from stampede_rt.transports.grpc_options import PUT_METHOD
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.request_pieces import messages_of
from stampede_rt_channel_host.channels.limits.memory import Charge, MemoryBudget
from stampede_rt_channel_host.channels.puts.read_ahead import ReadAhead
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.limits import Quota
from tests.support.channel_host.rig import run_of, running_host


class Requests:
    """A stream of equal requests without end."""

    def __init__(self, request: bytes) -> None:
        self.reads = self.release_calls = 0
        self._request = request

    async def read(self) -> Any:
        self.reads += 1
        return self._request

    def release(self) -> None:
        self.release_calls += 1


async def turns() -> None:
    for _ in range(50):
        await asyncio.sleep(0)


async def test_requests_read_ahead_are_charged_until_they_are_handled_or_the_stream_ends() -> None:
    memory, requests = MemoryBudget(2**30), Requests(bytes(2**20))
    ahead = ReadAhead(requests, memory, unlimited())
    await ahead.next()
    assert memory.used_bytes == 0
    ahead.start()
    await turns()
    assert memory.used_bytes == 4 * 2**20
    await ahead.next()  # the request that this returns still counts, because it may wait for the turn of its client
    assert memory.used_bytes == 4 * 2**20
    ahead.release()
    assert memory.used_bytes == 3 * 2**20
    assert requests.release_calls
    await ahead.next()
    ahead.close()
    assert memory.used_bytes == 0


async def test_nothing_is_read_ahead_on_any_stream_when_the_hosts_memory_is_used_up() -> None:
    memory, requests = MemoryBudget(3 * 2**20), Requests(bytes(2**20))
    streams = [ReadAhead(requests, memory, unlimited()) for _ in range(10)]
    for one in streams:
        one.start()
    await turns()
    assert memory.used_bytes <= 3 * 2**20 + len(streams) * 2**20  # each stream may end a read that it has begun
    before = requests.reads
    Charge(memory).set(3 * 2**20)
    late = ReadAhead(requests, memory, unlimited())
    late.start()
    await turns()
    assert requests.reads == before
    assert (await late.next())[0] is not EOF
    for one in streams:
        one.close()


async def test_nothing_is_read_ahead_for_a_caller_whose_bytes_in_flight_are_used_up() -> None:
    account = Account("cam", dict.fromkeys(Quota, 2 * 2**20))
    requests = Requests(bytes(2**20))
    ahead = [ReadAhead(requests, MemoryBudget(2**30), account) for _ in range(2)]
    for one in ahead:
        one.start()
    await turns()
    assert not account.has_room(Quota.BYTES_IN_FLIGHT)
    assert requests.reads <= 2 + len(ahead)  # each stream may end a read that it has begun
    for one in ahead:
        one.close()
    assert account.has_room(Quota.BYTES_IN_FLIGHT, 2 * 2**20)


def large_blocks(size: int) -> int:
    """The number of references to `bytes` of at least that size in this process."""
    return sum(
        isinstance(held, bytes) and len(held) >= size for one in gc.get_objects() for held in gc.get_referents(one)
    )


async def test_a_stream_that_waits_for_its_next_put_has_freed_the_memory_of_the_last_request() -> None:
    async with running_host(memory_bytes_max=2**20) as rig:
        channel = await rig.open()
        call: Any = rig.connection.stream_stream(PUT_METHOD, response_deserializer=pb.PutResponse.FromString)()
        size = 3 * 2**20
        known = {"channel_id": channel.channel_id, "epoch": channel.epoch}
        request = pb.PutRequest(puts=[run_of(bytes(size))], **known)
        for message in messages_of(request.SerializeToString()):
            await call.write(message)
        ack = (await call.read()).acks[0]
        assert ack.HasField("error")
        del request, message
        assert large_blocks(size) == 0
        call.cancel()
