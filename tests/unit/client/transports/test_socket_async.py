"""Streams over sockets on asyncio, against a service in the same process."""

from __future__ import annotations

import asyncio
import gc
import socket
import weakref
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import grpc
import pytest

from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.status import encode_status, from_rpc_error
from stampede_rt.transports import socket_async
from stampede_rt.transports.grpc_options import MESSAGE_BYTES_MAX
from stampede_rt.transports.socket_async import OpeningCall, SocketCall
from stampede_rt.transports.socket_limits import UNREAD_BYTES_MAX
from stampede_rt.wire.request_pieces import piece_in
from stampede_rt.wire.stream_frames import FrameKind, frame_of, head_of
from tests.support.socket_pairs import OPENING, RAW, FarEnd
from tests.support.socket_port import until


@asynccontextmanager
async def opened() -> AsyncIterator[tuple[SocketCall, FarEnd]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    near.setblocking(False)
    with far:
        call = await SocketCall.open(near, RAW, OPENING)
        end = FarEnd(far)
        assert end.frame() == (FrameKind.OPENING, OPENING)
        yield call, end
        call.cancel()
        await asyncio.sleep(0)


async def failure_of(call: SocketCall) -> grpc.RpcError:
    with pytest.raises(grpc.RpcError) as raised:
        await asyncio.wait_for(anext(call), 20)
    return raised.value


async def test_requests_and_responses_use_the_socket_until_the_regular_end() -> None:
    async with opened() as (call, far):
        done: asyncio.Future[SocketCall] = asyncio.get_running_loop().create_future()
        call.add_done_callback(done.set_result)
        await call.write(b"question")
        assert far.message() == b"question"
        far.socket.sendall(frame_of(FrameKind.ALIVE) + frame_of(FrameKind.MESSAGE, b"a") + frame_of(FrameKind.STATUS))
        assert [response async for response in call] == [b"a"]
        assert await done is call
        with pytest.raises(grpc.RpcError):
            await call.write(b"late")


@pytest.mark.parametrize(("request_bytes", "messages"), [(2**20, 1), (5 * 2**19, 3)])
async def test_a_large_request_is_sent_in_one_message_or_in_few_pieces(request_bytes: int, messages: int) -> None:
    async with opened() as (call, far):
        opening: asyncio.Future[SocketCall] = asyncio.get_running_loop().create_future()
        opening.set_result(call)
        request = bytes(range(256)) * (request_bytes // 256)
        writing = asyncio.create_task(OpeningCall(opening).write(request))
        found = [await asyncio.to_thread(far.message) for _ in range(messages)]
        await writing
        assert (found[0] if messages == 1 else b"".join(piece_in(one).content for one in found)) == request


async def test_a_large_request_over_grpc_is_sent_in_pieces_below_the_limit_of_grpc() -> None:
    class GrpcCall:
        def __init__(self) -> None:
            self.written: list[bytes] = []

        async def write(self, message: bytes) -> None:
            self.written.append(message)

        def add_done_callback(self, callback: object) -> None:
            pass

    call, opening = GrpcCall(), asyncio.get_running_loop().create_future()
    opening.set_result(call)
    await OpeningCall(opening).write(bytes(600_000))
    assert (len(call.written), max(map(len, call.written)) <= 2**18) == (3, True)


async def test_a_stream_that_is_cancelled_in_the_turn_in_which_it_opens_leaves_no_socket() -> None:
    async with opened() as (call, _):

        async def open_it() -> SocketCall:
            return call

        opening = OpeningCall(open_it())
        asyncio.get_running_loop().call_soon(opening.cancel)
        with pytest.raises(asyncio.CancelledError):
            await asyncio.wait_for(anext(call), 20)


async def test_an_error_of_the_service_arrives_with_its_details() -> None:
    async with opened() as (call, far):
        status = encode_status(InvalidArgument("not so", metadata={"field": "x"}))
        far.socket.sendall(frame_of(FrameKind.MESSAGE, b"last") + frame_of(FrameKind.STATUS, status))
        assert await anext(call) == b"last"
        for _ in range(2):
            error = from_rpc_error(await failure_of(call), "h1")
            assert isinstance(error, InvalidArgument)
            assert (error.message, error.metadata) == ("not so", {"field": "x"})


async def test_a_lost_connection_raises_unavailable() -> None:
    async with opened() as (call, far):
        far.socket.sendall(head_of(FrameKind.MESSAGE, 9) + b"half")
        far.socket.close()
        error = from_rpc_error(await failure_of(call), "h1")
        assert isinstance(error, Unavailable)
        assert error.message == "the connection to h1 broke (Socket closed: the host has closed it)"


async def test_a_message_over_the_limit_ends_the_stream_at_its_head() -> None:
    async with opened() as (call, far):
        far.socket.sendall(head_of(FrameKind.MESSAGE, MESSAGE_BYTES_MAX + 1))
        assert "are allowed" in str(await failure_of(call))


async def test_a_host_without_any_sign_of_life_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket_async, "SILENCE_S_MAX", 0.05)
    async with opened() as (call, _):
        assert "no sign of life for 0.05 s" in str(await failure_of(call))


async def test_unread_responses_stay_at_the_host_and_do_not_count_as_silence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(socket_async, "SILENCE_S_MAX", 0.3)
    async with opened() as (call, far):
        far.socket.setblocking(False)
        sent = bytearray(frame_of(FrameKind.MESSAGE, bytes(100_000)) * 20)
        loop = asyncio.get_running_loop()
        sending = asyncio.create_task(loop.sock_sendall(far.socket, sent))
        await asyncio.sleep(0.4)  # longer than the allowed silence
        assert call._unread_bytes <= 2 * UNREAD_BYTES_MAX + 100_000
        assert not sending.done()
        for _ in range(20):
            assert len(await asyncio.wait_for(anext(call), 20)) == 100_000
        await sending


async def test_a_cancel_ends_the_read_in_the_same_way_as_with_grpc() -> None:
    async with opened() as (call, far):
        asyncio.get_running_loop().call_soon(call.cancel)
        with pytest.raises(asyncio.CancelledError):
            await anext(call)
        await asyncio.sleep(0)
        assert far.frame() is None


async def test_a_stream_whose_opening_fails_or_is_cancelled_ends_with_the_reason() -> None:
    async def failing() -> SocketCall:
        raise Unavailable("no way")

    failed = OpeningCall(failing())
    done = asyncio.Event()
    failed.add_done_callback(lambda _: done.set())
    with pytest.raises(StampedeError, match="no way"):
        await anext(aiter(failed))
    await asyncio.wait_for(done.wait(), 20)
    cancelled = OpeningCall(asyncio.Event().wait())
    asyncio.get_running_loop().call_soon(cancelled.cancel)
    with pytest.raises(asyncio.CancelledError):
        await anext(aiter(cancelled))


@pytest.mark.parametrize("last", [frame_of(FrameKind.STATUS, encode_status(InvalidArgument("no"))), b"", None])
async def test_a_failed_stream_is_freed_without_the_garbage_collector(last: bytes | None) -> None:
    """In an earlier version the kept error of a stream referred to the stack frames of the reader.

    These frames referred to the stream.

    `last`: the bytes that the host sends before it closes the socket; None: this side cancels the stream.
    """
    gc.collect()
    gc.disable()
    try:
        async with opened() as (call, far):
            if last is None:
                call.cancel()
            else:
                far.socket.sendall(last)
                far.socket.shutdown(socket.SHUT_RDWR)
            for _ in range(2):
                with suppress(grpc.RpcError, asyncio.CancelledError):
                    await anext(call)
        ended = weakref.ref(call)
        del call
        for _ in range(10):  # the transport ends in a later turn
            await asyncio.sleep(0)
        assert ended() is None
    finally:
        gc.enable()


async def test_a_response_is_taken_in_the_turn_in_which_it_comes_if_the_user_waits_for_it() -> None:
    async with opened() as (call, far):
        taken: list[bytes] = []

        def take(response: bytes) -> bool:
            assert call.write_now is not None
            call.write_now(b"answer to " + response)
            taken.append(response)
            return response != b"last"

        call.take_in_same_turn = take
        far.socket.sendall(frame_of(FrameKind.MESSAGE, b"early"))
        await until(lambda: bool(call._received))
        assert await anext(call) == b"early", "no caller waited for the message when it came"
        reading = asyncio.ensure_future(anext(call))
        await asyncio.sleep(0)
        for message in (b"one", b"last"):
            far.socket.sendall(frame_of(FrameKind.MESSAGE, message))
            assert await asyncio.to_thread(far.message) == b"answer to " + message
        assert await asyncio.wait_for(reading, 20) == b"last", "`take_in_same_turn` has not taken the last message"
        assert taken == [b"one", b"last"]


async def test_responses_that_come_together_go_to_the_user() -> None:
    async with opened() as (call, far):
        call.take_in_same_turn = lambda _: True
        reading = asyncio.ensure_future(anext(call))
        await asyncio.sleep(0)
        far.socket.sendall(frame_of(FrameKind.MESSAGE, b"a") + frame_of(FrameKind.MESSAGE, b"b"))
        assert [await asyncio.wait_for(reading, 20), await anext(call)] == [b"a", b"b"]


async def test_the_user_gets_the_error_of_a_response_that_is_taken_in_the_turn_of_its_arrival() -> None:
    async with opened() as (call, far):

        def fail(_: bytes) -> bool:
            raise InvalidArgument("no such item")

        call.take_in_same_turn = fail
        reading = asyncio.ensure_future(anext(call))
        await asyncio.sleep(0)
        far.socket.sendall(frame_of(FrameKind.MESSAGE, b"a"))
        with pytest.raises(InvalidArgument, match="no such item"):
            await asyncio.wait_for(reading, 20)


async def test_a_call_that_has_ended_offers_no_write_without_a_wait() -> None:
    async with opened() as (call, _):
        call.cancel()
        assert call.write_now is None
