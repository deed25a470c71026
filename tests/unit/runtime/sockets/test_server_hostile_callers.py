"""Callers that open sockets and send nothing more, or bytes that are no stream."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from itertools import pairwise
from typing import Any

import grpc
import pytest

from stampede_rt.wire.stream_frames import OPENING_BYTES_MAX, FrameKind, frame_of, head_of
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.sockets import accepting, frame_buffers, server, stream_socket
from tests.support.raw_stream import raw_stream
from tests.support.socket_port import ECHO, HOLD, LOCAL, READ_LATER, TCP, Open, paused, port_fixture, until

port = port_fixture()
plain = port_fixture(LOCAL, TCP)
local = port_fixture(LOCAL)

INVALID = grpc.StatusCode.INVALID_ARGUMENT.value[0]
OVERDUE = grpc.StatusCode.DEADLINE_EXCEEDED.value[0]
OVERLOADED = grpc.StatusCode.RESOURCE_EXHAUSTED.value[0]


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (frame_of(FrameKind.MESSAGE, b"x"), "a stream begins with a StreamOpening"),
        (head_of(FrameKind.OPENING, OPENING_BYTES_MAX + 1), "are allowed"),
        (frame_of(FrameKind.OPENING, b"\xff\xff\xff"), "are no StreamOpening"),
        (frame_of(FrameKind.STATUS), "may not come here"),
        (b"GET / HTTP/1.1\r\n\r\n", "may not come here"),
        (b"\xff" * 100, "may not come here"),
    ],
)
async def test_a_connection_that_begins_with_other_bytes_than_an_opening_is_refused_immediately(
    port: Open, sent: bytes, why: str
) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.send_bytes(sent)
        status = await stream.status()
        assert (status.code, why in status.message) == (INVALID, True), status.message
        await stream.has_ended()


async def test_another_version_of_the_frames_is_refused(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(ECHO, version=2)
        status = await stream.status()
        assert "has version 2 of the frames of streams, and this service version 1" in status.message


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (head_of(FrameKind.MESSAGE, Limits().socket_request_bytes_max + 1), "are allowed"),
        (frame_of(FrameKind.OPENING), "came out of place"),
        (frame_of(FrameKind.ALIVE), "may not come here"),
        (frame_of(FrameKind.END) + frame_of(FrameKind.MESSAGE, b"x"), "came out of place"),
    ],
)
async def test_a_forbidden_frame_ends_the_stream(port: Open, sent: bytes, why: str) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(READ_LATER)
        await one.streams.held.acquire()
        await stream.send_bytes(sent)
        status = await stream.status()
        assert (status.code, why in status.message) == (INVALID, True), status.message
        await asyncio.wait_for(one.streams.cancelled.acquire(), 20)


async def test_a_socket_without_an_opening_is_ended_after_a_while(port: Open) -> None:
    async with port(limits=Limits(handshake_millis_max=400)) as one:
        for begun in (b"", b"\x10", head_of(FrameKind.OPENING, 100) + b"x" * 99):
            async with raw_stream(one.target) as stream:
                await stream.send_bytes(begun)
                status = await stream.status()
                assert status.code == OVERDUE
                assert "no whole StreamOpening came within 0.4 s" in status.message


async def test_a_frame_that_is_never_finished_is_ended_after_a_while(
    port: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream_socket, "FRAME_SECONDS_MAX", 0.05)
    monkeypatch.setattr(server, "ALIVE_SECONDS", 0.02)
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(ECHO)
        await stream.send_bytes(head_of(FrameKind.MESSAGE, 1000) + b"x")
        status = await stream.status()
        assert status.code == OVERDUE
        assert "6 bytes of a frame came, but the rest did not come within 0.05 s" in status.message


async def test_a_frame_that_arrives_byte_by_byte_ends_its_stream_after_a_while(
    port: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream_socket, "FRAME_SECONDS_MAX", 0.05)
    monkeypatch.setattr(server, "ALIVE_SECONDS", 0.02)
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(ECHO)
        await stream.send_bytes(head_of(FrameKind.MESSAGE, 100_000))
        status = asyncio.ensure_future(stream.status())
        while not status.done():
            stream.writer.write(b"x")
            await asyncio.sleep(0.005)
        assert (await status).code == OVERDUE


async def test_the_number_of_sockets_without_an_opening_is_limited(plain: Open) -> None:
    async with (
        plain(limits=Limits(refusals_max=2)) as one,
        raw_stream(one.target) as a,
        raw_stream(one.target) as b,
    ):
        for stream in (a, b):
            await stream.send_bytes(b"\x01")
        async with raw_stream(one.target) as stream:
            assert (await stream.status()).code == OVERLOADED
        assert one.server.refused_calls.count == 1
        a.writer.transport.abort()
        await until(lambda: sum(map(len, one.server.sockets._unopened.values())) == 1)
        async with raw_stream(one.target) as stream:
            await stream.begin(HOLD)
            await asyncio.wait_for(one.streams.held.acquire(), 20)


async def test_a_server_leaves_some_file_descriptors_free_for_its_process(
    plain: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "connections_max", lambda: 2)
    async with plain() as one, raw_stream(one.target) as first, raw_stream(one.target) as second:
        await first.begin(HOLD)
        await one.streams.held.acquire()
        assert (await second.status()).code == OVERLOADED


async def test_before_a_caller_is_admitted_the_port_reads_only_its_opening(
    port: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "OPENED_PER_TURN", 0)
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(HOLD)
        made = await paused(one)
        stream.writer.write(frame_of(FrameKind.MESSAGE, bytes(100_000)) * 20)
        for _ in range(100):
            await asyncio.sleep(0)
        assert made._unread_bytes + made._frames.unfinished_bytes == 0
        monkeypatch.setattr(server, "OPENED_PER_TURN", 2)
        await asyncio.wait_for(one.streams.held.acquire(), 20)


async def test_many_streams_that_open_together_begin_a_few_in_each_turn_of_the_loop(
    local: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with local() as one:
        begun: list[int] = []
        begin = one.server.sockets._begin_some

        def counted() -> None:
            before = sum(found.task is not None for found in one.server.sockets._streams.values())
            begin()
            begun.append(sum(found.task is not None for found in one.server.sockets._streams.values()) - before)

        monkeypatch.setattr(one.server.sockets, "_begin_some", counted)
        async with contextlib.AsyncExitStack() as stack:
            streams = [await stack.enter_async_context(raw_stream(one.target)) for _ in range(20)]
            for stream in streams:
                await stream.begin(HOLD)
            for _ in streams:
                await asyncio.wait_for(one.streams.held.acquire(), 20)
        assert max(begun) <= server.OPENED_PER_TURN


async def test_many_openings_of_one_caller_delay_another_caller_by_one_opening(
    local: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[str] = []
    serve = server.SocketServer._serve

    async def noted(self: server.SocketServer, stream: Any, opening: Any) -> None:
        begun.append(opening.authorization.removeprefix("Bearer "))
        await serve(self, stream, opening)

    monkeypatch.setattr(server.SocketServer, "_serve", noted)
    monkeypatch.setattr(server, "OPENED_PER_TURN", 0)
    async with local() as one, contextlib.AsyncExitStack() as stack:
        for secret in (*["many"] * 10, "good"):
            await (await stack.enter_async_context(raw_stream(one.target))).begin(HOLD, secret=secret)
        await until(lambda: sum(map(len, one.server.sockets._openings.values())) == 11)
        monkeypatch.setattr(server, "OPENED_PER_TURN", 2)
        await until(lambda: len(begun) == 11)
    assert begun.index("good") == 1


async def test_connections_are_accepted_a_few_at_a_time(local: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    async with local() as one, contextlib.AsyncExitStack() as stack:
        acceptor = one.server.sockets._acceptors[0]
        acceptor._loop.remove_reader(acceptor._listening)
        accept, take, pause = acceptor._accept_some, acceptor._take, acceptor._pause
        accepted: list[socket.socket] = []
        counts: list[int] = []
        pauses_s: list[float] = []

        def accept_some() -> None:
            accept()
            counts.append(len(accepted))

        def taken(connection: socket.socket) -> None:
            accepted.append(connection)
            take(connection)

        def paused_for(seconds: float) -> None:
            pauses_s.append(seconds)
            pause(seconds)

        monkeypatch.setattr(acceptor, "_accept_some", accept_some)
        monkeypatch.setattr(acceptor, "_take", taken)
        monkeypatch.setattr(acceptor, "_pause", paused_for)
        streams = [await stack.enter_async_context(raw_stream(one.target)) for _ in range(20)]
        acceptor.start()
        for stream in streams:
            await stream.begin(HOLD)
            await asyncio.wait_for(one.streams.held.acquire(), 20)
    steps = [after - before for before, after in pairwise([0, *counts])]
    assert max(steps) == accepting.ACCEPTED_PER_TURN
    assert pauses_s == [accepting.PAUSE_SECONDS] * (20 // accepting.ACCEPTED_PER_TURN)


async def test_a_server_without_a_free_file_accepts_again_later(local: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accepting, "RETRY_SECONDS", 0.01)
    async with local() as one:
        acceptor = one.server.sockets._acceptors[0]
        listening, failures = acceptor._listening, [OSError(errno.EMFILE, "Too many open files")]

        class Full:
            fileno = staticmethod(listening.fileno)
            close = staticmethod(listening.close)

            def accept(self) -> Any:
                if failures:
                    raise failures.pop()
                return listening.accept()

        acceptor._listening = Full()  # type: ignore[assignment]
        async with raw_stream(one.target) as stream:
            await stream.begin(HOLD)
            await asyncio.wait_for(one.streams.held.acquire(), 20)
    assert not failures


@pytest.mark.parametrize("is_waited_for", [False, True], ids=["with the opening", "while the method reads"])
async def test_many_unfinished_frames_of_one_caller_take_bounded_memory(
    plain: Open, monkeypatch: pytest.MonkeyPatch, *, is_waited_for: bool
) -> None:
    monkeypatch.setattr(frame_buffers, "PLACES", 2)
    frame = frame_of(FrameKind.MESSAGE, bytes(200_000))
    async with plain() as one, contextlib.AsyncExitStack() as stack:
        streams = [await stack.enter_async_context(raw_stream(one.target)) for _ in range(10)]
        for stream in streams:
            await stream.begin(ECHO)
            if is_waited_for:
                await stream.send(FrameKind.MESSAGE, b"x")
                assert await stream.message() == b"x"
            stream.writer.write(frame[:-1])
        made = one.server.sockets._streams
        await until(lambda: sum(found._is_paused for found in made) == 8)
        await until(lambda: sum(found._frames.missing_bytes == 1 for found in made) == 2)
        assert sum(len(found._frames._partial) for found in made) <= 2 * len(frame) + 8 * frame_buffers.SHORT_BYTES
        for stream in streams:  # the streams wait for a place, and in the end each gets one
            stream.writer.write(frame[-1:])
        for stream in streams:
            assert await stream.message() == frame[5:]


async def test_the_buffer_of_a_frame_that_never_ends_is_passed_to_another_stream(
    plain: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_buffers, "PLACES", 1)
    frame = frame_of(FrameKind.MESSAGE, bytes(200_000))
    async with plain() as one, raw_stream(one.target) as first, raw_stream(one.target) as second:
        for stream in (first, second):
            await stream.begin(ECHO)
            stream.writer.write(frame[:-1])
        made = one.server.sockets._streams
        await until(lambda: [found._is_paused for found in made] == [False, True])
        [begun, _] = made
        first.writer.transport.abort()
        second.writer.write(frame[-1:])
        assert await second.message() == frame[5:]
        assert begun._frames.unfinished_bytes == 0, "the bytes stay although the stream has ended"


async def test_a_stream_that_is_cancelled_while_it_waits_for_a_buffer_takes_none(
    plain: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_buffers, "PLACES", 1)
    frame = frame_of(FrameKind.MESSAGE, bytes(200_000))
    async with plain() as one, raw_stream(one.target) as first:
        await first.begin(ECHO)
        first.writer.write(frame[:-1])
        async with raw_stream(one.target) as second:
            await second.begin(ECHO)
            second.writer.write(frame[:-1])
            await until(lambda: [found._is_paused for found in one.server.sockets._streams] == [False, True])
        await until(lambda: len(one.server.sockets._streams) == 1)
        first.writer.write(frame[-1:] + frame)
        assert [await first.message() for _ in range(2)] == [frame[5:]] * 2


async def test_a_stream_reads_nothing_while_its_long_frame_waits_for_a_buffer(
    plain: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_buffers, "PLACES", 1)
    whole, long = frame_of(FrameKind.MESSAGE, bytes(200_000)), frame_of(FrameKind.MESSAGE, bytes(20_000))
    short = [frame_of(FrameKind.MESSAGE, name) for name in (b"1", b"2", b"3")]
    async with plain() as one, raw_stream(one.target) as first, raw_stream(one.target) as second:
        for stream in (first, second):
            await stream.begin(ECHO)
        first.writer.write(whole[:-1])
        made = one.server.sockets._streams
        await until(lambda: sum(found._is_filling for found in made) == 1)
        second.writer.write(short[0] + short[1] + long[:3000])
        assert [await second.message() for _ in range(2)] == [b"1", b"2"]
        second.writer.write(long[3000:] + short[2])  # one more read makes the rest short
        await until(lambda: sum(found._is_paused for found in made) == 1)
        first.writer.write(whole[-1:])
        assert await first.message() == whole[5:]
        assert [await second.message() for _ in range(2)] == [long[5:], b"3"]


async def test_a_socket_of_another_user_is_refused(local: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "is_of_this_user", lambda connected: False)
    async with local() as one, raw_stream(one.target) as stream:
        status = await stream.status()
        assert status.code == grpc.StatusCode.PERMISSION_DENIED.value[0]
        assert "another user" in status.message


async def test_unread_empty_messages_count_as_the_memory_that_they_take(port: Open) -> None:
    async with port() as one, raw_stream(one.target) as stream:
        await stream.begin(READ_LATER)
        await one.streams.held.acquire()
        stream.writer.write(frame_of(FrameKind.MESSAGE) * 100_000)
        await until(lambda: one.server.sockets._streams and next(iter(one.server.sockets._streams))._messages)
        made = await paused(one)
        assert len(made._messages) <= (2 * Limits().unread_bytes_max) // 5 + Limits().unread_bytes_max // 64
