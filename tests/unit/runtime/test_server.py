"""The gRPC server of a service: its port, its limits and its end."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt.transports import grpc_options
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.listen import CannotListen
from stampede_rt_runtime.server import DRAIN_SECONDS, ServiceServer, serving

SERVING = health_pb2.HealthCheckResponse.SERVING
NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING


class Probe:
    """Raw-bytes methods: Echo answers; Hold answers once and then stays open until it is let go."""

    def __init__(self) -> None:
        self.held = asyncio.Event()
        self.let_go = asyncio.Event()

    def register(self, server: grpc.aio.Server) -> None:
        methods = {
            "Echo": grpc.unary_unary_rpc_method_handler(self.echo),
            "Hold": grpc.unary_stream_rpc_method_handler(self.hold),
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test.Probe", methods),))

    async def echo(self, request: bytes, context: Any) -> bytes:
        return request

    async def hold(self, request: bytes, context: Any) -> AsyncIterator[bytes]:
        yield b"held"
        self.held.set()
        await self.let_go.wait()
        yield b"bye"


async def health_of(address: str) -> int:
    async with dial(address, secret=None) as channel:
        answer = await health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest(), timeout=5)
    return answer.status


async def test_port_0_becomes_the_port_that_was_bound() -> None:
    async with serving(Probe().register) as server:
        host, port = server.address.rsplit(":", 1)
        assert host == "localhost"
        assert int(port) > 0


async def test_a_bound_port_is_known_and_taken_before_the_server_starts_and_callers_wait_for_it() -> None:
    server = ServiceServer(secret=None)
    Probe().register(server.grpc)
    address = server.bind("localhost:0")
    with pytest.raises(CannotListen, match=f"{address} is in use"):
        ServiceServer(secret=None).bind(address)
    async with dial(address, secret=None) as channel:
        call = channel.unary_unary("/test.Probe/Echo")(b"patient", timeout=10)
        await asyncio.sleep(0)  # the call is on its way
        await server.start()
        assert await call == b"patient"
    await server.stop()


async def test_a_second_server_on_the_same_port_is_refused() -> None:
    async with serving(Probe().register) as first:
        with pytest.raises(CannotListen, match=f"{first.address} is in use"):
            ServiceServer(secret=None).bind(first.address)


async def test_a_port_taken_between_check_and_bind_is_refused_too(monkeypatch: pytest.MonkeyPatch) -> None:
    async with serving(Probe().register) as first:
        monkeypatch.setattr("stampede_rt_runtime.listen._try_bind", lambda *_: None)
        with pytest.raises(CannotListen, match="cannot listen at"):
            ServiceServer(secret=None).bind(first.address)


async def test_health_is_not_serving_until_the_service_is_ready() -> None:
    server = ServiceServer(secret=None)
    address = server.bind("localhost:0")
    await server.start()
    assert await health_of(address) == NOT_SERVING
    await server.set_serving(True)
    assert await health_of(address) == SERVING
    await server.stop()


async def test_a_stopping_server_reports_not_serving_and_lets_streams_finish() -> None:
    probe = Probe()
    seen: list[int] = []

    async with serving(probe.register) as server, dial(server.address, secret=None) as channel:
        stream = channel.unary_stream("/test.Probe/Hold")(b"", timeout=10)
        assert await stream.read() == b"held"

        async def end_streams() -> None:
            seen.append(await health_of(server.address))
            probe.let_go.set()

        stopping = asyncio.create_task(server.stop(end_streams))
        assert await stream.read() == b"bye"
        assert await stream.read() is grpc.aio.EOF
        await stopping
    assert seen == [NOT_SERVING]


async def test_a_stop_cancels_a_stream_that_does_not_end_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stampede_rt_runtime.server.DRAIN_SECONDS", 0.05)
    probe = Probe()
    async with serving(probe.register) as server, dial(server.address, secret=None) as channel:
        stream = channel.unary_stream("/test.Probe/Hold")(b"", timeout=10)
        assert await stream.read() == b"held"
        await asyncio.wait_for(server.stop(asyncio.Event().wait), 45)
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await stream.read()
    assert caught.value.code() in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_stop_signal_ends_the_run_of_a_server(number: signal.Signals) -> None:
    server = ServiceServer(secret=None)
    server.bind("localhost:0")
    await server.start()
    running = asyncio.create_task(server.run())
    asyncio.get_running_loop().call_soon(os.kill, os.getpid(), number)
    await asyncio.wait_for(running, 45)
    assert server.stopping.is_set()


async def test_a_second_signal_ends_a_stopping_server_immediately() -> None:
    probe = Probe()
    server = ServiceServer(secret=None)
    probe.register(server.grpc)
    address = server.bind("localhost:0")
    await server.start()
    async with dial(address, secret=None) as channel:
        stream = channel.unary_stream("/test.Probe/Hold")(b"", timeout=10)
        assert await stream.read() == b"held"
        draining = asyncio.Event()

        async def end_streams() -> None:
            draining.set()

        server.stopping.set()
        running = asyncio.create_task(server.run(end_streams))
        await draining.wait()
        began = asyncio.get_running_loop().time()
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.wait_for(running, 45)
        assert asyncio.get_running_loop().time() - began < DRAIN_SECONDS / 2


async def test_a_request_beyond_the_size_limit_is_refused() -> None:
    small, large = Limits(message_bytes_max=1000), Limits()
    async with (
        serving(Probe().register, limits=small) as server,
        dial(server.address, secret=None, limits=large) as channel,
    ):
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await channel.unary_unary("/test.Probe/Echo")(b"x" * 1001, timeout=5)
    assert caught.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_a_message_of_19_mib_passes_both_ways_if_the_server_accepts_large_requests() -> None:
    payload = bytes(19 * 2**20)
    async with (
        serving(Probe().register, limits=Limits(request_bytes_max=20 * 2**20)) as server,
        dial(server.address, secret=None) as channel,
    ):
        assert await channel.unary_unary("/test.Probe/Echo")(payload, timeout=20) == payload


async def test_calls_beyond_the_limit_are_refused_and_the_others_continue() -> None:
    probe = Probe()
    async with (
        serving(probe.register, limits=Limits(concurrent_rpcs_max=1)) as server,
        dial(server.address, secret=None) as channel,
    ):
        stream = channel.unary_stream("/test.Probe/Hold")(b"", timeout=10)
        assert await stream.read() == b"held"
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await channel.unary_unary("/test.Probe/Echo")(b"", timeout=5)
        probe.let_go.set()
        assert await stream.read() == b"bye"
    assert caught.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_metadata_beyond_the_limit_is_refused() -> None:
    async with serving(Probe().register) as server, dial(server.address, secret=None) as channel:
        call = channel.unary_unary("/test.Probe/Echo")(b"", timeout=5, metadata=(("x", "y" * 40_000),))
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await call
    assert caught.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_a_caller_that_pings_as_often_as_grpc_lets_it_keeps_an_idle_stream() -> None:
    """Both sides ping each second, the shortest time that gRPC allows.

    A server that allows fewer pings ends the stream.
    """
    probe = Probe()
    pinging = Limits(keepalive_millis=1_000)
    strict = Limits(ping_interval_millis_min=60_000)
    async with (
        serving(probe.register) as lenient_server,
        serving(probe.register, limits=strict) as strict_server,
        dial(lenient_server.address, secret=None, limits=pinging) as kept,
        dial(strict_server.address, secret=None, limits=pinging) as cut,
    ):
        idle = kept.unary_stream("/test.Probe/Hold")(b"", timeout=30)
        doomed = cut.unary_stream("/test.Probe/Hold")(b"", timeout=30)
        assert await idle.read() == await doomed.read() == b"held"
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await doomed.read()
        probe.let_go.set()
        assert await idle.read() == b"bye"
    assert "ping" in str(caught.value.details())


def test_no_caller_of_ours_pings_more_often_than_servers_allow() -> None:
    """In an earlier version, clients pinged every 10 s, and servers allowed a ping every 10 s.

    Half of the pings came a moment too early.
    """
    allowed = dict(Limits().server_options())["grpc.http2.min_ping_interval_without_data_ms"]
    for options in (Limits().channel_options(), grpc_options.CHANNEL_OPTIONS):
        assert int(dict(options)["grpc.keepalive_time_ms"]) >= 2 * int(allowed)
