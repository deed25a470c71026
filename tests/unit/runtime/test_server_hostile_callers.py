"""Callers that begin calls and send nothing more, or bytes that are no request."""

from __future__ import annotations

import asyncio
import logging
import resource
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime import open_files
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.limits import CONTROL_LIMITS, Limits
from stampede_rt_runtime.server import serving
from tests.support.raw_http2 import RawConnection

CHECK = "/grpc.health.v1.Health/Check"
LIST = "/stampede_rt.v1.DirectoryService/ListChannels"
WATCH = "/stampede_rt.v1.DirectoryService/Watch"
FOLLOW = "/stampede_rt.v1.DirectoryService/Follow"
HOLD = "/stampede_rt.v1.DirectoryService/Hold"
READ = "/stampede_rt.v1.DirectoryService/Read"
SECRET = Secret(text="right", path=Path("secret"))
FIRST = asyncio.FIRST_COMPLETED
NO_REQUEST = b"\xff\xff\xff"
LIMIT_S = 60.0


class Directory(grpc.GenericRpcHandler):
    """One method of each kind of call. It keeps the requests."""

    def __init__(self) -> None:
        self.requests: list[Any] = []

    def service(self, details: grpc.HandlerCallDetails) -> Any:
        kinds: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
            LIST: (grpc.unary_unary_rpc_method_handler, self.list),
            WATCH: (grpc.unary_stream_rpc_method_handler, self.watch),
            FOLLOW: (grpc.stream_stream_rpc_method_handler, self.follow),
            HOLD: (grpc.stream_stream_rpc_method_handler, self.hold),
            READ: (grpc.stream_stream_rpc_method_handler, self.read),
        }
        if details.method not in kinds:
            return None
        make, behavior = kinds[details.method]
        return make(behavior, pb.ListChannelsRequest.FromString, pb.ListChannelsResponse.SerializeToString)

    async def list(self, request: pb.ListChannelsRequest, _context: Any) -> pb.ListChannelsResponse:
        self.requests.append(request)
        return pb.ListChannelsResponse(next_page_token=request.name_glob)

    async def watch(self, request: pb.ListChannelsRequest, _context: Any) -> AsyncIterator[pb.ListChannelsResponse]:
        self.requests.append(request)
        yield pb.ListChannelsResponse(next_page_token=request.name_glob)

    async def follow(self, requests: Any, context: Any) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._echo_all(context))

    async def read(self, requests: Any, context: Any) -> None:
        while await context.read() is not grpc.aio.EOF:
            pass

    async def hold(self, requests: Any, context: Any) -> None:
        await asyncio.Event().wait()

    async def _echo_all(self, context: Any) -> None:
        while (request := await context.read()) is not grpc.aio.EOF:
            await context.write(pb.ListChannelsResponse(next_page_token=request.name_glob))


class Port:
    """A server, its directory, and a channel of a caller to it."""

    def __init__(self, directory: Directory, address: str, channel: grpc.aio.Channel) -> None:
        self.directory, self.address, self.channel = directory, address, channel

    async def list(self, glob: str) -> str:
        call = self.channel.unary_unary(
            LIST, pb.ListChannelsRequest.SerializeToString, pb.ListChannelsResponse.FromString
        )
        response: pb.ListChannelsResponse = await call(pb.ListChannelsRequest(name_glob=glob), timeout=LIMIT_S)
        return response.next_page_token

    async def sent(self, method: str, *messages: bytes) -> tuple[grpc.StatusCode, str]:
        """The answer to a call that sends these bytes and then ends."""
        while True:  # ends with the test's timeout
            call: Any = self.channel.stream_stream(method)(iter(messages), timeout=LIMIT_S)  # type: ignore[arg-type]
            code, details = await call.code(), await call.details()
            if details != "Internal error from Core":  # grpc.aio was still sending when the answer came, and lost it
                return code, details


@asynccontextmanager
async def port(
    secret: Secret | None = None, limits: Limits | None = None, *, brings: bool = True
) -> AsyncIterator[Port]:
    directory = Directory()

    def register(server: grpc.aio.Server) -> None:
        server.add_generic_rpc_handlers((directory,))

    async with (
        serving(register, secret=secret, limits=limits) as server,
        dial(server.address, secret=secret if brings else None) as channel,
    ):
        yield Port(directory, server.address, channel)


@pytest.mark.parametrize("method", [LIST, WATCH])
async def test_a_call_whose_request_does_not_arrive_ends_and_frees_its_slot(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_runtime.requests.REQUEST_SECONDS_MAX", 0.05)
    async with port(limits=Limits(concurrent_rpcs_max=2, streams_max=2)) as one:
        silent: list[Any] = [one.channel.stream_stream(method)(timeout=LIMIT_S) for _ in range(2)]
        for call in silent:
            assert await call.code() is grpc.StatusCode.DEADLINE_EXCEEDED
            assert f"no whole request of {method} came within 0.05 s" in await call.details()
        monkeypatch.setattr("stampede_rt_runtime.requests.REQUEST_SECONDS_MAX", LIMIT_S)  # good calls get more time
        assert await one.list("cam/*") == "cam/*"
        assert await one.sent(method) == (
            grpc.StatusCode.INVALID_ARGUMENT,
            f"{method} was called without a request; send one",
        )


async def test_a_server_reads_only_a_few_unfinished_requests_of_a_caller_at_the_same_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("stampede_rt_runtime.requests.READS_MAX", 3)
    limits = Limits(request_bytes_max=2**20)
    async with port(limits=limits) as one:
        raw = await RawConnection.open(one.address)
        await raw.greeted.wait()
        streams = [await raw.call(LIST) for _ in range(10)]
        sending = [
            asyncio.create_task(raw.send_as_allowed(stream, limits.request_bytes_max, limits.request_bytes_max - 1))
            for stream in streams
        ]

        async def read(number: int) -> list[int]:
            """The streams that the server reads, once there are `number` of them."""
            async with asyncio.timeout(LIMIT_S):
                while sum(task.done() for task in sending) < number:
                    await asyncio.wait({task for task in sending if not task.done()}, return_when=FIRST)
            return [stream for stream in streams if raw.allowed_bytes[stream] > limits.unread_bytes_max]

        first = await read(3)
        assert len(first) == 3
        for stream in first:
            await raw.reset(stream)
        assert len(await read(6)) == 6
        for task in sending:
            task.cancel()
        await raw.aclose()


@pytest.mark.parametrize("method", [LIST, WATCH, FOLLOW])
async def test_bytes_that_are_no_request_are_refused_without_a_traceback(
    method: str, caplog: pytest.LogCaptureFixture
) -> None:
    async with port() as one:
        with caplog.at_level(logging.DEBUG):
            code, details = await one.sent(method, NO_REQUEST)
    assert code is grpc.StatusCode.INVALID_ARGUMENT
    assert f"the 3 bytes that were sent are no request of {method}" in details
    assert one.directory.requests == []
    assert [record.levelname for record in caplog.records if record.levelno > logging.DEBUG] == []


@pytest.mark.parametrize("method", [LIST, WATCH, FOLLOW])
async def test_a_caller_without_a_secret_is_refused_before_anything_is_read(method: str) -> None:
    async with port(SECRET, brings=False) as one:
        code, _ = await one.sent(method, NO_REQUEST)
        assert code in (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED)
        raw = await RawConnection.open(one.address)
        stream = await raw.call(method)
        await raw.begin_message(stream, 20 * 2**20, 1000)
        async with asyncio.timeout(LIMIT_S):
            await raw.ended[stream].wait()
        await raw.aclose()


async def test_any_caller_may_check_the_health_but_not_with_large_or_slow_requests() -> None:
    async with port(SECRET, brings=False, limits=Limits(concurrent_rpcs_max=4, refusals_max=4)) as one:
        raw = await RawConnection.open(one.address)
        streams = [await raw.call(CHECK) for _ in range(500)]
        for stream in streams[:50]:
            await raw.begin_message(stream, 20 * 2**20, 500)
        async with asyncio.timeout(LIMIT_S):
            for stream in streams:
                await raw.ended[stream].wait()
        assert max(raw.allowed_bytes.values()) < 20 * 2**20  # the server never asked for the rest
        await raw.aclose()
        check = one.channel.unary_unary(
            CHECK, health_pb2.HealthCheckRequest.SerializeToString, health_pb2.HealthCheckResponse.FromString
        )
        for service in ("", "stampede_rt.v1.DirectoryService"):
            answer = await check(health_pb2.HealthCheckRequest(service=service), timeout=LIMIT_S)
            assert answer.status == health_pb2.HealthCheckResponse.SERVING


async def test_a_connection_has_a_limited_number_of_calls_and_a_caller_with_more_calls_opens_another_connection() -> (
    None
):
    async with port(limits=Limits(calls_per_connection_max=8)) as one:
        raw = await RawConnection.open(one.address)
        await raw.greeted.wait()
        assert raw.streams_max == 8
        await raw.aclose()
        held: list[Any] = [one.channel.stream_stream(FOLLOW)(timeout=LIMIT_S) for _ in range(30)]
        for call in held:
            await call.write(pb.ListChannelsRequest(name_glob="x").SerializeToString())
            await call.read()
        assert await one.list("beside") == "beside"
        for call in held:
            call.cancel()


async def test_a_caller_cannot_send_more_than_a_small_window_on_an_unread_stream() -> None:
    limits = Limits()
    async with port() as one:
        raw = await RawConnection.open(one.address)
        await raw.greeted.wait()
        read, unread = await raw.call(READ), await raw.call(HOLD)
        message = pb.ListChannelsRequest(name_glob="x" * 200_000).SerializeToString()
        for _ in range(40):  # a fast stream must not widen the windows of the others
            await raw.send_message_as_allowed(read, message)
        await raw.send_as_allowed(unread, limits.request_bytes_max, limits.unread_bytes_max - 10)
        await raw.send_message_as_allowed(read, message)
        assert raw.allowed_bytes[unread] <= limits.unread_bytes_max
        await raw.aclose()


async def test_a_message_above_the_limit_is_refused_before_it_has_arrived() -> None:
    async with port() as one:
        raw = await RawConnection.open(one.address)
        await raw.greeted.wait()
        stream = await raw.call(FOLLOW)
        await raw.begin_message(stream, Limits().request_bytes_max + 1, 100)
        async with asyncio.timeout(LIMIT_S):
            await raw.ended[stream].wait()
        await raw.aclose()


async def test_servers_of_the_directory_refuse_messages_as_large_as_an_item() -> None:
    async with port(limits=CONTROL_LIMITS) as one:
        code, _ = await one.sent(LIST, bytes(5 * 2**20))
        assert code is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert await one.list("a") == "a"


def test_a_server_limits_its_connections_and_keeps_file_descriptors_free(monkeypatch: pytest.MonkeyPatch) -> None:
    def allow(files: int) -> int:
        monkeypatch.setattr(resource, "getrlimit", lambda _: (files, files))
        return open_files.connections_max()

    assert allow(1024) == 768
    assert allow(100) == 50
    assert allow(1_000_000) == open_files.CONNECTIONS_MAX
    assert allow(resource.RLIM_INFINITY) == open_files.CONNECTIONS_MAX
