"""Readiness apart from liveness, in the standard health service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt_runtime import health
from stampede_rt_runtime.health import LIVENESS, READINESS, READS_MAX
from stampede_rt_runtime.server import ServiceServer

SERVING = health_pb2.HealthCheckResponse.SERVING
NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING
CHECK = "/grpc.health.v1.Health/Check"


@pytest.fixture
async def server() -> AsyncIterator[ServiceServer]:
    made = ServiceServer(secret=None)
    made.bind("localhost:0")
    await made.start()
    yield made
    await made.stop()


async def status(server: ServiceServer, name: str) -> int:
    async with grpc.aio.insecure_channel(server.address) as channel:
        request = health_pb2.HealthCheckRequest(service=name)
        answer = await health_pb2_grpc.HealthStub(channel).Check(request, timeout=10)
        return int(answer.status)


async def _answer(call: Any) -> bytes:
    return bytes(await call)


async def test_a_service_that_cannot_serve_is_live_but_not_ready(server: ServiceServer) -> None:
    assert [await status(server, name) for name in (LIVENESS, READINESS, "")] == [SERVING, NOT_SERVING, NOT_SERVING]
    await server.set_serving(True)
    assert [await status(server, name) for name in (LIVENESS, READINESS, "")] == [SERVING, SERVING, SERVING]
    await server.set_serving(False)
    assert [await status(server, name) for name in (LIVENESS, READINESS, "")] == [SERVING, NOT_SERVING, NOT_SERVING]


async def test_a_watch_reports_the_health_of_the_named_service(server: ServiceServer) -> None:
    async with grpc.aio.insecure_channel(server.address) as channel:
        stub = health_pb2_grpc.HealthStub(channel)
        live = stub.Watch(health_pb2.HealthCheckRequest(service=LIVENESS), timeout=10)
        ready = stub.Watch(health_pb2.HealthCheckRequest(service=READINESS), timeout=10)
        assert (await live.read()).status == SERVING
        assert (await ready.read()).status == NOT_SERVING
        await server.set_serving(True)
        assert (await ready.read()).status == SERVING


async def test_a_caller_with_a_request_displaces_callers_that_send_none(
    server: ServiceServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "READ_SECONDS_MAX", 3600.0)
    async with grpc.aio.insecure_channel(server.address) as channel:
        silent = [channel.stream_unary(CHECK)(timeout=60) for _ in range(READS_MAX + 3)]
        answers = [asyncio.ensure_future(_answer(call)) for call in silent]
        first = asyncio.as_completed(answers)
        for _ in range(3):  # the callers above READS_MAX
            assert health_pb2.HealthCheckResponse.FromString(await next(first)).status == NOT_SERVING
        assert await status(server, LIVENESS) == SERVING
        for call in silent:
            call.cancel()
        await asyncio.gather(*answers, return_exceptions=True)


async def test_a_malformed_health_request_gets_the_readiness(server: ServiceServer) -> None:
    async with grpc.aio.insecure_channel(server.address) as channel:
        raw = await asyncio.wait_for(channel.unary_unary(CHECK)(b"\xff\xff"), 45)
        assert health_pb2.HealthCheckResponse.FromString(raw).status == NOT_SERVING
