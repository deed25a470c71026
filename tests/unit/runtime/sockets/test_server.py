"""Streams over sockets are served as streams over gRPC are."""

from __future__ import annotations

import asyncio
import logging
import socket
from pathlib import Path
from typing import Any

import grpc
import pytest

from stampede_rt.errors import InvalidArgument, StampedeError, WrongCluster
from stampede_rt.status import DETAILS_KEY, error_in
from stampede_rt.v1 import rpc_status_pb2
from stampede_rt.wire.stream_frames import FrameKind, frame_of
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.overload import RefusedCalls
from stampede_rt_runtime.quotas.working import GRPC_COSTS, SOCKET_COSTS
from stampede_rt_runtime.sockets import server, stream_socket
from stampede_rt_runtime.sockets.frame_buffers import FrameBuffers
from stampede_rt_runtime.sockets.openings import unread_by_peer
from tests.support.raw_stream import RawStream, raw_stream
from tests.support.socket_port import (
    ECHO,
    FAIL,
    FLOOD,
    HOLD,
    LOCAL,
    READ_LATER,
    REFUSE,
    SAME_TURN,
    TCP,
    Open,
    Streams,
    port_fixture,
    until,
)

port = port_fixture()
plain = port_fixture(LOCAL, TCP)
local = port_fixture(LOCAL)

SECRET = Secret(text="right", path=Path("secret"))
OVERLOADED, UNAUTHENTICATED = grpc.StatusCode.RESOURCE_EXHAUSTED.value[0], grpc.StatusCode.UNAUTHENTICATED.value[0]


def error_of(status: rpc_status_pb2.Status) -> StampedeError:
    found = error_in(((DETAILS_KEY, status.SerializeToString()),))
    assert found is not None
    return found


async def echoed(stream: RawStream, *, secret: str = "") -> None:
    await stream.begin(ECHO, secret=secret)
    await stream.send(FrameKind.MESSAGE, b"hello")
    assert await stream.message() == b"hello"


async def test_a_stream_reads_and_writes_and_ends(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(ECHO)
        for message in (b"", b"a", bytes(200_000)):
            await stream.send(FrameKind.MESSAGE, message)
            assert await stream.message() == message
        await stream.send(FrameKind.END)
        assert (await stream.status()).code == 0
        await stream.has_ended()


async def test_later_frames_reuse_the_memory_of_a_long_frame(port: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    taken, original = list[bytearray](), FrameBuffers.take_buffer

    def take_buffer(self: FrameBuffers, frame_bytes: int) -> bytearray:
        taken.append(original(self, frame_bytes))
        return taken[-1]

    monkeypatch.setattr(FrameBuffers, "take_buffer", take_buffer)
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(ECHO)
        for _ in range(3):
            await stream.send(FrameKind.MESSAGE, bytes(200_000))
            await stream.message()
    assert (len(taken), taken[1] is taken[0], taken[2] is taken[0]) == (3, True, True)


async def test_an_error_reaches_the_caller_with_its_code_and_details(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(REFUSE)
        status = await stream.status()
        assert status.code == grpc.StatusCode.INVALID_ARGUMENT.value[0]
        error = error_of(status)
        assert isinstance(error, InvalidArgument)
        assert (error.message, error.metadata) == ("not like this", {"field": "x"})


async def test_a_method_may_answer_messages_as_they_arrive_and_reads_the_unanswered_ones(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(SAME_TURN)
        for message in (b"short", b"longer", b"x", bytes(100_000)):
            await stream.send(FrameKind.MESSAGE, message)
            assert await stream.message() in (message, b"same turn: " + message)
        await stream.send_bytes(frame_of(FrameKind.MESSAGE, b"a") + frame_of(FrameKind.MESSAGE, b"b"))
        assert [await stream.message(), await stream.message()] == [b"a", b"b"], (
            "two messages that come together go to the method"
        )
        await stream.send(FrameKind.MESSAGE, b"short")
        assert await stream.message() == b"same turn: short"
        await stream.send(FrameKind.END)
        assert (await stream.status()).code == 0


async def test_a_defect_while_a_message_is_answered_on_arrival_ends_the_stream_with_unknown_and_is_logged(
    port: Open, caplog: pytest.LogCaptureFixture
) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(SAME_TURN)
        await stream.send(FrameKind.MESSAGE, b"x")
        await stream.message()
        await stream.send(FrameKind.MESSAGE, b"defect")
        assert (await stream.status()).code == grpc.StatusCode.UNKNOWN.value[0]
    assert [record.exc_info is not None for record in caplog.records if record.levelno >= logging.ERROR] == [True]


async def test_the_status_reaches_a_caller_that_is_still_sending(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(REFUSE)
        for _ in range(50):
            stream.writer.write(bytes(5) + bytes(1000))
        assert (await stream.status()).message == "not like this"


async def test_a_defect_ends_the_stream_with_unknown_and_is_logged(
    port: Open, caplog: pytest.LogCaptureFixture
) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(FAIL)
        assert (await stream.status()).code == grpc.StatusCode.UNKNOWN.value[0]
    assert [record.exc_info is not None for record in caplog.records if record.levelno >= logging.ERROR] == [True]


async def test_only_a_caller_with_the_secret_is_served(plain: Open) -> None:
    async with plain(secret=SECRET) as one:
        for secret in ("", "wrong"):
            async with raw_stream(one.target) as stream:
                await stream.begin(ECHO, secret=secret)
                assert (await stream.status()).code == UNAUTHENTICATED
        async with raw_stream(one.target) as stream:
            await stream.begin("/test.Streams/None")
            assert (await stream.status()).code == UNAUTHENTICATED
        async with raw_stream(one.target) as stream:
            await stream.begin("/test.Streams/None", secret="right")
            assert (await stream.status()).code == grpc.StatusCode.UNIMPLEMENTED.value[0]
        async with raw_stream(one.target) as stream:
            await echoed(stream, secret="right")


async def test_a_caller_of_another_cluster_is_refused(port: Open) -> None:
    async with port(judge_cluster=lambda named: WrongCluster("mine is a") if named != "a" else None) as one:
        async with raw_stream(one.target) as stream:
            await stream.begin(ECHO, cluster="b")
            assert isinstance(error_of(await stream.status()), WrongCluster)
        async with raw_stream(one.target) as stream:
            await stream.begin(ECHO, cluster="a")
            await stream.send(FrameKind.END)
            assert (await stream.status()).code == 0


async def test_streams_over_sockets_and_over_grpc_count_towards_the_same_limits(plain: Open) -> None:
    limits = Limits(concurrent_rpcs_max=4, streams_max=2)
    async with plain(limits=limits) as one, grpc.aio.insecure_channel(one.server.address) as channel:
        over_grpc: Any = channel.stream_stream(HOLD)(timeout=20)
        await one.streams.held.acquire()
        async with raw_stream(one.target) as first, raw_stream(one.target) as second:
            await first.begin(HOLD)
            await one.streams.held.acquire()
            await second.begin(HOLD)
            assert (await second.status()).code == OVERLOADED
            third: Any = channel.stream_stream(HOLD)(timeout=20)
            assert await third.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        await one.streams.cancelled.acquire()
        async with raw_stream(one.target) as stream:
            await stream.begin(HOLD)
            await one.streams.held.acquire()
        over_grpc.cancel()


async def test_a_closing_stream_accepts_no_further_messages(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(HOLD)
        await one.streams.held.acquire()
        [made] = one.server.sockets._streams
        made.abort()
        with pytest.raises(grpc.aio.InternalError):
            await made.write(b"late")
        made.look(1.0)
        made.end(b"")


async def test_a_close_cancels_the_method(port: Open) -> None:
    async with port() as one:
        async with raw_stream(one.target) as stream:
            await stream.begin(HOLD)
            await one.streams.held.acquire()
        await asyncio.wait_for(one.streams.cancelled.acquire(), 20)


async def test_a_close_cancels_immediately_a_method_that_reads_no_further_messages(port: Open) -> None:
    async with port() as one:
        async with raw_stream(one.target) as stream:
            await stream.begin(READ_LATER)
            await one.streams.held.acquire()
            stream.writer.write(b"".join(bytes((160, 134, 1, 0, 0)) + bytes(100_000) for _ in range(20)))
            [made] = one.server.sockets._streams
            await until(lambda: made._unread_bytes and made._is_paused)
        await asyncio.wait_for(one.streams.cancelled.acquire(), 20)


async def test_unread_bytes_are_left_in_the_socket_and_read_later(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(READ_LATER)
        await one.streams.held.acquire()
        for _ in range(100):
            stream.writer.write(bytes((160, 134, 1, 0, 0)) + bytes(100_000))
        stream.writer.write(bytes((0, 0, 0, 0, 3)))
        [made] = one.server.sockets._streams
        await until(lambda: made._unread_bytes and made._is_paused)
        kept = made._unread_bytes + made._frames.unfinished_bytes
        assert kept <= 2 * Limits().unread_bytes_max + Limits().socket_request_bytes_max
        one.streams.may_read.set()
        assert (await stream.status()).code == 0
        assert one.streams.read_bytes == 100 * 100_000


async def test_a_caller_that_reads_nothing_is_disconnected_after_a_while(
    port: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream_socket, "STALL_SECONDS_MAX", 0.05)
    monkeypatch.setattr(server, "ALIVE_SECONDS", 0.02)
    async with port() as one, raw_stream(one.target) as stream:
        stream.writer.transport.pause_reading()  # type: ignore[attr-defined]
        await stream.begin(FLOOD)
        await asyncio.wait_for(one.streams.cancelled.acquire(), 20)


async def test_an_idle_stream_gets_the_next_sign_of_life_only_after_its_caller_has_read_the_last_one(
    local: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "ALIVE_SECONDS", 0.01)
    async with local() as one, raw_stream(one.target) as stream:
        await echoed(stream)
        for _ in range(3):
            assert await stream.frame() == (FrameKind.ALIVE, b"")
        [made] = one.server.sockets._streams
        stream.writer.transport.pause_reading()  # type: ignore[attr-defined]
        for now_s in range(10):
            made.look(float(now_s))
        assert unread_by_peer(made.socket)
        stream.writer.transport.resume_reading()  # type: ignore[attr-defined]
        assert len(await stream.reader.read(1000)) <= 2 * len(stream_socket.ALIVE)


async def test_a_stop_waits_for_streams_and_then_ends_them(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(HOLD)
        await one.streams.held.acquire()
        await one.server.sockets.stop(0.01)
        await stream.has_ended()
        await asyncio.wait_for(one.streams.cancelled.acquire(), 20)
        with pytest.raises(OSError):
            async with raw_stream(one.target):
                pass


async def test_a_stream_over_a_socket_counts_with_the_costs_of_sockets(
    plain: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, streams over sockets counted with the costs of gRPC, 250 us for a message, and got too
    small a share.
    """
    found: list[object] = []

    async def note_costs(_self: Streams, _requests: Any, context: Any) -> None:
        found.append((current_work()._costs, context._work._costs))

    monkeypatch.setattr(Streams, "hold", note_costs)
    async with plain() as one:
        async with raw_stream(one.target) as stream:
            await stream.begin(HOLD)
            await stream.status()
        async with grpc.aio.insecure_channel(one.server.address) as channel:
            assert await channel.stream_stream(HOLD)().read() is grpc.aio.EOF
    assert found == [(SOCKET_COSTS, SOCKET_COSTS), (GRPC_COSTS, GRPC_COSTS)]


async def test_a_connection_that_was_accepted_as_the_service_ends_is_closed() -> None:
    """In an earlier version, the service cancelled the connection's task before its first step, and nothing closed the
    socket.
    """
    ours, theirs = socket.socketpair()
    with ours:
        ending = server.SocketServer([], Limits(), RefusedCalls())
        ending._accepted_locally(theirs)
        await ending.stop(0)
        await until(lambda: theirs.fileno() < 0)
