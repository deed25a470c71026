"""Streams over sockets on threads, against a service in the same process."""

from __future__ import annotations

import gc
import os
import signal
import socket
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress

import grpc
import pytest

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.status import encode_status, from_rpc_error
from stampede_rt.transports import socket_sync
from stampede_rt.transports.grpc_options import MESSAGE_BYTES_MAX
from stampede_rt.transports.socket_sync import SocketCall
from stampede_rt.wire.request_pieces import piece_in
from stampede_rt.wire.stream_frames import FrameKind, frame_of, head_of
from tests.support.socket_pairs import OPENING, RAW, FarEnd

LARGE = bytes(200_000)


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, FarEnd]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with far:
        yield near, FarEnd(far)


def opened(pair: tuple[socket.socket, FarEnd], *, in_turn: bool = True) -> tuple[SocketCall, FarEnd]:
    near, far = pair
    call = SocketCall(near, RAW, OPENING, in_turn=in_turn)
    assert far.frame() == (FrameKind.OPENING, OPENING)
    return call, far


def failure_of(call: SocketCall) -> grpc.RpcError:
    with pytest.raises(grpc.RpcError) as raised:
        next(call)
    return raised.value


def test_requests_and_responses_use_the_socket_until_the_regular_end(
    pair: tuple[socket.socket, FarEnd],
) -> None:
    call, far = opened(pair)
    call.send(b"question")
    assert far.message() == b"question"
    far.socket.sendall(frame_of(FrameKind.ALIVE) + frame_of(FrameKind.MESSAGE, b"a") + frame_of(FrameKind.MESSAGE))
    assert [next(call), next(call)] == [b"a", b""]
    far.send(FrameKind.STATUS)
    assert list(call) == []
    assert list(call) == []
    assert far.frame() is None  # the client has closed its socket


@pytest.mark.parametrize(("request_bytes", "messages"), [(2**20, 1), (5 * 2**19, 3)])
def test_a_large_request_is_sent_in_one_message_or_in_few_pieces(
    pair: tuple[socket.socket, FarEnd], request_bytes: int, messages: int
) -> None:
    call, far = opened(pair, in_turn=False)
    request = bytes(range(256)) * (request_bytes // 256)
    call.send(request)
    found = [far.message() for _ in range(messages)]
    assert (found[0] if messages == 1 else b"".join(piece_in(one).content for one in found)) == request


def test_an_error_of_the_service_arrives_with_its_details_after_the_messages_before_it(
    pair: tuple[socket.socket, FarEnd],
) -> None:
    call, far = opened(pair)
    status = encode_status(InvalidArgument("not so", metadata={"field": "x"}))
    far.socket.sendall(frame_of(FrameKind.MESSAGE, b"last") + frame_of(FrameKind.STATUS, status))
    far.socket.close()
    call.send(b"into nowhere")  # the status has the reason
    assert next(call) == b"last"
    for _ in range(2):
        error = from_rpc_error(failure_of(call), "h1")
        assert isinstance(error, InvalidArgument)
        assert (error.message, error.metadata, error.from_service) == ("not so", {"field": "x"}, True)


@pytest.mark.parametrize("sent", [b"", head_of(FrameKind.MESSAGE, 9) + b"half"])
def test_a_lost_connection_raises_unavailable(pair: tuple[socket.socket, FarEnd], sent: bytes) -> None:
    call, far = opened(pair)
    far.socket.sendall(sent)
    far.socket.close()
    error = from_rpc_error(failure_of(call), "h1")
    assert isinstance(error, Unavailable)
    assert error.message == "the connection to h1 broke (Socket closed: the host has closed it)"


def test_a_message_over_the_limit_ends_the_stream_at_its_head(pair: tuple[socket.socket, FarEnd]) -> None:
    call, far = opened(pair)
    far.socket.sendall(head_of(FrameKind.MESSAGE, MESSAGE_BYTES_MAX + 1))
    assert "are allowed" in str(failure_of(call))
    assert far.frame() is None


def test_a_host_without_any_sign_of_life_is_given_up(
    pair: tuple[socket.socket, FarEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_sync, "SILENCE_S_MAX", 0.05)
    call, _ = opened(pair)
    error = from_rpc_error(failure_of(call), "h1")
    assert isinstance(error, Unavailable)
    assert "h1 cannot be reached (no sign of life for 0.05 s)" in error.message


def test_a_host_that_takes_no_request_and_gives_no_sign_of_life_is_given_up(
    pair: tuple[socket.socket, FarEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_sync, "SILENCE_S_MAX", 0.05)
    call, _ = opened(pair)
    call.send(bytes(2**20))
    assert "no sign of life" in str(failure_of(call))


def test_a_large_request_waits_as_long_as_a_busy_host_gives_signs_of_life(
    pair: tuple[socket.socket, FarEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket_sync, "SILENCE_S_MAX", 2.0)
    call, far = opened(pair)
    request = os.urandom(250_000)
    sent = threading.Event()

    def send() -> None:
        for _ in range(4):
            call.send(request)
        sent.set()

    threading.Thread(target=send, daemon=True).start()
    for _ in range(5):
        far.send(FrameKind.ALIVE)
        assert not sent.wait(0.01)
    assert [far.message() for _ in range(4)] == [request] * 4
    assert sent.wait(20)


def test_requests_of_several_threads_to_a_slow_host_arrive_complete_without_blocking_each_other(
    pair: tuple[socket.socket, FarEnd],
) -> None:
    call, far = opened(pair, in_turn=False)
    requests = [bytes([number]) * 100_000 for number in range(20)]
    senders = [threading.Thread(target=call.send, args=(request,)) for request in requests]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join(20)
    assert call.waiting_requests > 10
    assert sorted(far.message() for _ in requests) == requests
    call.send(b"last")
    assert far.message() == b"last"


def test_a_cancel_on_another_thread_ends_the_reading(pair: tuple[socket.socket, FarEnd]) -> None:
    call, far = opened(pair)
    threading.Timer(0.01, call.cancel).start()
    assert failure_of(call).code() is grpc.StatusCode.CANCELLED  # type: ignore[attr-defined]
    assert far.frame() is None


def test_a_dropped_stream_closes_its_socket_and_ends_its_thread(pair: tuple[socket.socket, FarEnd]) -> None:
    call, far = opened(pair, in_turn=False)
    for _ in range(5):
        call.send(LARGE)
    assert call.waiting_requests
    [sender] = [thread for thread in threading.enumerate() if thread.name == "stampede sends"]
    del call
    gc.collect()
    sender.join(20)
    assert not sender.is_alive()
    while far.socket.recv(2**16):
        pass


def test_a_forked_child_neither_keeps_nor_ends_the_connection_of_its_parent(
    pair: tuple[socket.socket, FarEnd],
) -> None:
    call, far = opened(pair)
    child = os.fork()
    if not child:
        call.cancel()
        time.sleep(60)
        os._exit(0)
    try:
        far.send(FrameKind.MESSAGE, b"still here")
        assert next(call) == b"still here"
        call.send(b"too")
        assert far.message() == b"too"
        del call
        gc.collect()
        assert far.frame() is None  # although the child lives
    finally:
        os.kill(child, 9)
        os.waitpid(child, 0)


def test_a_read_ends_at_its_limit_although_the_host_gives_signs_of_life(pair: tuple[socket.socket, FarEnd]) -> None:
    call, far = opened(pair)
    over = threading.Event()

    def live() -> None:
        with suppress(OSError):  # the limit closes the connection
            while not over.wait(0.01):
                far.send(FrameKind.ALIVE)

    sender = threading.Thread(target=live)
    sender.start()
    try:
        with call.limit(0.2) as overdue:
            assert failure_of(call).code() is grpc.StatusCode.CANCELLED
    finally:
        over.set()
        sender.join(20)
    assert overdue


def test_a_read_ends_at_its_limit_although_many_signals_come(pair: tuple[socket.socket, FarEnd]) -> None:
    call, _ = opened(pair)
    former = signal.signal(signal.SIGALRM, lambda *_: None)
    signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
    try:
        with call.limit(0.2) as overdue:
            assert failure_of(call).code() is grpc.StatusCode.CANCELLED
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)
    assert overdue


def test_a_request_that_the_host_does_not_take_ends_at_its_limit(pair: tuple[socket.socket, FarEnd]) -> None:
    call, _ = opened(pair)
    with call.limit(0.05) as overdue:
        call.send(bytes(2**20))
        failure_of(call)
    assert overdue


def test_a_limit_ends_with_its_block_and_starts_no_thread(pair: tuple[socket.socket, FarEnd]) -> None:
    threads = threading.active_count()
    call, far = opened(pair)
    for timeout_s in (0.0, None, 10.0):
        far.send(FrameKind.MESSAGE, b"answer")
        with call.limit(10.0) as overdue:
            assert next(call) == b"answer"
        with call.limit(timeout_s):
            pass
        assert not overdue
    assert threading.active_count() == threads


def test_later_messages_do_not_change_earlier_ones(pair: tuple[socket.socket, FarEnd]) -> None:
    """The stream reads all bytes into one buffer."""
    call, far = opened(pair)
    sent = [os.urandom(size) for size in (1, 3000, 100_000, 5, 400_000, 0, 70_000)]
    received = []
    for message in sent:
        writing = threading.Thread(target=far.send, args=(FrameKind.MESSAGE, message))
        writing.start()
        received.append(next(call))
        writing.join()
    assert received == sent


@pytest.mark.parametrize(
    ("parts", "size", "messages"), [(4, 2**18, 1), (1000, 300, 1), (58, 18_000, 1), (5, 2**20, 5), (3, 10, 1)]
)
def test_a_request_in_parts_arrives_as_one_message(
    pair: tuple[socket.socket, FarEnd], parts: int, size: int, messages: int
) -> None:
    call, far = opened(pair, in_turn=False)
    request = [bytes([number % 251]) * size for number in range(parts)]
    call.send(request)
    found = [far.message() for _ in range(messages)]
    whole = found[0] if messages == 1 else b"".join(piece_in(one).content for one in found)
    assert whole == b"".join(request)


def test_a_full_request_of_medium_items_is_sent_without_a_copy_of_its_payloads() -> None:
    heads, payloads = [b"head"] * 20, [bytes(18_000) for _ in range(57)]
    [frame] = socket_sync._buffers_of([*heads, *payloads])
    assert [id(part) for part in frame[-57:]] == [id(payload) for payload in payloads]
    [frame] = socket_sync._buffers_of([bytes(300)] * 400)  # short parts are joined in less time than sent
    assert len(frame) == 2


@pytest.mark.parametrize(("request_bytes", "parts"), [(0, 1), (4096, 1), (4097, 2)])
def test_a_short_request_is_sent_in_one_part(request_bytes: int, parts: int) -> None:
    [frame] = socket_sync._buffers_of(bytes(request_bytes))
    assert len(frame) == parts
    assert b"".join(frame) == frame_of(FrameKind.MESSAGE, bytes(request_bytes))


@pytest.mark.parametrize("sent_bytes", range(1, 12))
def test_the_rest_of_a_write_begins_after_the_sent_bytes(sent_bytes: int) -> None:
    parts = [b"abc", b"", b"defg", b"hijkl"]
    assert b"".join(socket_sync._after(parts, sent_bytes)) == b"abcdefghijkl"[sent_bytes:]


@pytest.mark.parametrize("last", [frame_of(FrameKind.STATUS, encode_status(InvalidArgument("no"))), b"", None])
def test_a_failed_stream_is_freed_without_the_garbage_collector(
    pair: tuple[socket.socket, FarEnd], last: bytes | None
) -> None:
    """In an earlier version, a frame kept the error in a variable, and the error referred to the frame. Both kept the
    stream, with its buffers of 128 KiB.

    `last`: the bytes that the host sends before it closes the socket; None: this side cancels the stream.
    """
    gc.collect()
    gc.disable()
    try:
        call, far = opened(pair)
        if last is None:
            call.cancel()
        else:
            far.socket.sendall(last)
            far.socket.shutdown(socket.SHUT_RDWR)
        for _ in range(2):
            with suppress(grpc.RpcError):
                next(call)
        ended = weakref.ref(call)
        del call
        assert ended() is None
    finally:
        gc.enable()
