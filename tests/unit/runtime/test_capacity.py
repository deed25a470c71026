"""Callers' streams that fill a port, and the calls that the port still admits."""

from __future__ import annotations

import asyncio
from typing import Any

import grpc
import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.status import from_rpc_error
from stampede_rt_runtime.capacity import Slots
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.pacing import STREAMS_PER_TURN, TurnGate
from stampede_rt_runtime.requests import reading_late
from stampede_rt_runtime.server import serving

WATCH = "/stampede_rt.v1.DirectoryService/Watch"
PING = "/stampede_rt.v1.DirectoryService/Ping"
RAFT = "/stampede_rt.v1.RaftService/Exchange"
RENEW = "/stampede_rt.v1.DirectoryService/RenewHostLease"
LIMITS = Limits(concurrent_rpcs_max=4, streams_max=2, reserved_rpcs_max=2)


class AnsweringService(grpc.GenericRpcHandler):
    """Streams answer once and stay open until they are cancelled; the other calls answer."""

    def service(self, handler_call_details: grpc.HandlerCallDetails) -> Any:
        if handler_call_details.method in (WATCH, RAFT):
            return grpc.stream_stream_rpc_method_handler(self.hold)
        return grpc.unary_unary_rpc_method_handler(self.echo)

    async def hold(self, _requests: Any, context: Any) -> None:
        await context.write(b"open")
        await asyncio.Event().wait()

    async def echo(self, request: bytes, context: Any) -> bytes:
        return request


def register(server: grpc.aio.Server) -> None:
    server.add_generic_rpc_handlers((AnsweringService(),))


async def opened(channel: grpc.aio.Channel, method: str) -> Any:
    call = channel.stream_stream(method)(timeout=20)
    assert await call.read() == b"open"
    return call


async def test_a_port_full_of_watches_still_serves_members_lease_renewals_and_single_calls() -> None:
    async with serving(register, limits=LIMITS) as server, dial(server.address, secret=None) as channel:
        watches = [await opened(channel, WATCH) for _ in range(LIMITS.streams_max)]
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await opened(channel, WATCH)
        error = from_rpc_error(caught.value, server.address)
        assert server.refused_calls.count == 1
        member = await opened(channel, RAFT)
        assert await channel.unary_unary(RENEW)(b"mine", timeout=20) == b"mine"
        assert await channel.unary_unary(PING)(b"you", timeout=20) == b"you"
        for call in (*watches, member):
            call.cancel()
    assert isinstance(error, Overloaded)
    assert "2 streams are open at this port, as many as it serves" in error.message


async def test_single_requests_that_arrive_together_are_handled_a_few_in_each_turn() -> None:
    """In an earlier version, one turn of the event loop took all requests. 32 requests of one caller took 4 ms."""
    may_arrive, calls, turns = asyncio.Event(), 40, list[int]()
    gate, done = TurnGate(), 0

    class LateRequest:
        async def read(self) -> bytes:
            await may_arrive.wait()
            return b"request"

    async def answer(_request: bytes, _context: Any) -> bytes:
        nonlocal done
        done += 1
        return b""

    handler = reading_late(PING, grpc.unary_unary_rpc_method_handler(answer), gate)
    tasks = [asyncio.create_task(handler.stream_unary(None, LateRequest())) for _ in range(calls)]
    await asyncio.sleep(0)
    may_arrive.set()
    while done < calls:
        before = done
        await asyncio.sleep(0)
        turns.append(done - before)
    await asyncio.gather(*tasks)
    assert max(turns) <= 2 * STREAMS_PER_TURN, turns


async def test_an_ended_stream_makes_room_for_another() -> None:
    async with serving(register, limits=LIMITS) as server, dial(server.address, secret=None) as channel:
        watches = [await opened(channel, WATCH) for _ in range(LIMITS.streams_max)]
        watches[0].cancel()
        while True:  # ends with the test's timeout: the server learns of the cancellation a little later
            try:
                watches.append(await opened(channel, WATCH))
                break
            except grpc.aio.AioRpcError as error:
                if error.code() is not grpc.StatusCode.RESOURCE_EXHAUSTED:
                    raise
        for call in watches:
            call.cancel()


def test_a_call_without_a_free_reserved_slot_takes_a_common_slot() -> None:
    slots = Slots(LIMITS)
    given = [slots.take(is_stream=True, closed_to_clients=True) for _ in range(3)]
    assert (slots.reserved, slots.streams, slots.singles) == (2, 1, 0)
    for give_back in given:
        give_back()
    assert (slots.reserved, slots.streams, slots.singles) == (0, 0, 0)


def test_single_calls_that_fill_all_slots_leave_none_for_a_stream() -> None:
    slots = Slots(LIMITS)
    for _ in range(LIMITS.concurrent_rpcs_max):
        slots.take(is_stream=False, closed_to_clients=False)
    with pytest.raises(Overloaded, match="4 calls are under way"):
        slots.take(is_stream=False, closed_to_clients=False)
    with pytest.raises(Overloaded, match="4 calls are under way"):
        slots.take(is_stream=True, closed_to_clients=False)


def test_single_calls_of_one_caller_leave_slots_for_others() -> None:
    """In an earlier version, one client with unfinished requests took all slots of a port for ten seconds."""
    slots = Slots(Limits(concurrent_rpcs_max=8, streams_max=4, reserved_rpcs_max=2))
    given = [slots.take(is_stream=number < 2, closed_to_clients=False, subject="greedy") for number in range(6)]
    for is_stream in (False, True):
        with pytest.raises(Overloaded, match="greedy has 6 calls under way at this port, the most for one caller"):
            slots.take(is_stream=is_stream, closed_to_clients=False, subject="greedy")
    slots.take(is_stream=False, closed_to_clients=True, subject="greedy")
    slots.take(is_stream=False, closed_to_clients=False, subject="good")
    slots.take(is_stream=True, closed_to_clients=False)
    for give_back in given:
        give_back()
    assert (slots.streams, slots.singles, slots.reserved) == (1, 1, 1)
    assert dict(slots._slots_of_callers) == {"good": 1}
