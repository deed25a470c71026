"""Calls whose reading thread takes gRPC's events itself, and the same calls over the public interface of gRPC."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.status import DETAILS_KEY
from stampede_rt.transports import single_thread_call
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.grpc_sync import ServerEndpoint
from stampede_rt.transports.single_thread_call import STREAMS_VARIABLE, CallEnded, SingleThreadCall
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX
from tests.support.waiting import wait_until


class Peer(grpc.GenericRpcHandler):
    """Put answers each message with its length; Get waits; Subscribe ends as the first message says."""

    def __init__(self) -> None:
        self.calls_ended = 0

    def service(self, details: Any) -> Any:
        behaviors = {"Put": self._lengths, "Get": self._silent, "Subscribe": self._status}
        return grpc.stream_stream_rpc_method_handler(behaviors[details.method.rpartition("/")[2]])

    def _lengths(self, requests: Iterator[bytes], context: Any) -> Iterator[bytes]:
        for request in requests:
            yield pb.PutResponse(acks=[pb.PutAck(items=len(request))]).SerializeToString()

    def _silent(self, requests: Iterator[bytes], context: Any) -> Iterator[bytes]:
        ended = threading.Event()

        def end() -> None:
            self.calls_ended += 1
            ended.set()

        context.add_callback(end)
        yield pb.GetResponse(call_id=1).SerializeToString()
        ended.wait()

    def _status(self, requests: Iterator[bytes], context: Any) -> Iterator[bytes]:
        wish = pb.SubscribeRequest.FromString(next(requests)).credit_bytes
        if wish == 1:
            context.set_trailing_metadata(((DETAILS_KEY, b"why"),))
            context.abort(grpc.StatusCode.NOT_FOUND, "no such channel")
        yield b"\xff" if wish == 2 else b""


@pytest.fixture
def peer() -> Iterator[tuple[Peer, str]]:
    handler = Peer()
    server = grpc.server(ThreadPoolExecutor(8), handlers=(handler,))
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield handler, f"127.0.0.1:{port}"
    server.stop(0).wait()


@pytest.fixture(params=["", "public"])
def endpoint(
    request: pytest.FixtureRequest, peer: tuple[Peer, str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[ServerEndpoint]:
    monkeypatch.setenv(STREAMS_VARIABLE, request.param)
    endpoint = ServerEndpoint(peer[1], lambda: ())
    call = begun(endpoint, endpoint._put)
    assert isinstance(call, SingleThreadCall) is (request.param != "public")
    call.cancel()
    yield endpoint
    endpoint.close()


def begun(endpoint: ServerEndpoint, method: BidiMethod) -> Any:
    return endpoint.begin_bidi(method, keeps_reading=True)


def in_thread(work: Callable[[], Any]) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_one_thread_sends_and_another_one_reads(endpoint: ServerEndpoint) -> None:
    call = begun(endpoint, endpoint._put)
    sizes = [*range(1, 400), MESSAGE_BYTES_MAX]
    sender = in_thread(lambda: [call.send(bytes(size)) for size in sizes])
    assert [next(call).acks[0].items for _ in sizes] == sizes
    sender.join()
    call.cancel()


def test_a_large_request_is_sent_in_pieces_while_the_caller_reads(endpoint: ServerEndpoint) -> None:
    call = begun(endpoint, endpoint._put)
    call.send(bytes(3 * MESSAGE_BYTES_MAX))
    lengths = [next(call).acks[0].items for _ in range(4)]
    assert max(lengths) <= MESSAGE_BYTES_MAX < 3 * MESSAGE_BYTES_MAX < sum(lengths)
    call.cancel()


def test_many_threads_have_calls_on_one_channel(endpoint: ServerEndpoint) -> None:
    def exchange(size: int) -> list[int]:
        call, found = begun(endpoint, endpoint._put), []
        for _ in range(50):
            call.send(bytes(size))
            found.append(next(call).acks[0].items)
        call.cancel()
        return found

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(exchange, range(1, 5))) == [[size] * 50 for size in range(1, 5)]


@pytest.mark.parametrize("end", ["cancel", "close"])
def test_another_thread_ends_a_read(endpoint: ServerEndpoint, peer: tuple[Peer, str], end: str) -> None:
    call = begun(endpoint, endpoint.channels.Get)
    assert next(call).call_id == 1
    failures: list[Any] = []

    def read() -> None:
        try:
            next(call)
        except grpc.RpcError as error:
            failures.append(error)

    reader = in_thread(read)
    call.cancel() if end == "cancel" else endpoint.close()
    reader.join()
    assert failures[0].code() is grpc.StatusCode.CANCELLED
    wait_until(lambda: peer[0].calls_ended == 1)


def test_the_status_and_trailers_of_a_call_can_be_read_repeatedly(endpoint: ServerEndpoint) -> None:
    call = begun(endpoint, endpoint.channels.Subscribe)
    call.send(pb.SubscribeRequest(credit_bytes=1))
    for _ in range(2):
        with pytest.raises(grpc.RpcError) as raised:
            next(call)
        error: Any = raised.value
        assert (error.code(), error.details()) == (grpc.StatusCode.NOT_FOUND, "no such channel")
        assert dict(error.trailing_metadata())[DETAILS_KEY] == b"why"
        call.send(pb.SubscribeRequest())  # a message sent after the end is dropped


def test_a_call_that_the_server_ended_with_ok_stops(endpoint: ServerEndpoint) -> None:
    call = begun(endpoint, endpoint.channels.Subscribe)
    call.send(pb.SubscribeRequest())
    assert list(call) == [pb.SubscribeResponse()]


def test_a_response_of_another_kind_is_an_error_of_the_call(endpoint: ServerEndpoint) -> None:
    call = begun(endpoint, endpoint.channels.Subscribe)
    call.send(pb.SubscribeRequest(credit_bytes=2))
    with pytest.raises(grpc.RpcError, match="deserializing") as raised:
        next(call)
    error: Any = raised.value
    assert error.code() is grpc.StatusCode.INTERNAL


def test_a_closed_channel_begins_no_call(endpoint: ServerEndpoint) -> None:
    endpoint.close()
    with pytest.raises(Unavailable, match="is closed"):
        begun(endpoint, endpoint._put)


@pytest.mark.parametrize("end", ["read", "cancel", "status"])
def test_grpc_frees_a_call_that_has_ended(peer: tuple[Peer, str], end: str) -> None:
    endpoint = ServerEndpoint(peer[1], lambda: ())
    call: Any = begun(endpoint, endpoint.channels.Get if end != "status" else endpoint.channels.Subscribe)
    if end == "status":
        call.send(pb.SubscribeRequest(credit_bytes=1))
        with pytest.raises(CallEnded):
            next(call)
    else:
        next(call)
        call.cancel()
        if end == "read":
            with pytest.raises(CallEnded):
                next(call)
    assert call._events == 0, "the last event is taken; with it gRPC frees the call"
    call.cancel()
    endpoint.close()


def test_after_an_interrupt_a_call_takes_no_event_of_grpc(peer: tuple[Peer, str]) -> None:
    endpoint = ServerEndpoint(peer[1], lambda: ())
    call: Any = begun(endpoint, endpoint.channels.Get)
    next(call)
    grpcs_call, taken = call._call, []

    class Interrupted:
        cancel, operate = grpcs_call.cancel, grpcs_call.operate

        def next_event(self) -> Any:
            taken.append(1)
            raise KeyboardInterrupt

    call._call = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        next(call)
    with pytest.raises(CallEnded, match="interrupt"):
        next(call)
    call.send(pb.GetRequest())
    call.cancel()
    assert taken == [1]
    wait_until(lambda: peer[0].calls_ended == 1)
    endpoint.close()


@pytest.mark.parametrize("lacking", ["_channel", "segregated_call"])
def test_without_the_private_names_of_grpcio_the_public_interface_serves(
    peer: tuple[Peer, str], lacking: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = ServerEndpoint(peer[1], lambda: ())
    begin = single_thread_call.begin

    class Lacking:
        _channel = object()

    monkeypatch.setattr(
        single_thread_call,
        "begin",
        lambda channel, *rest: begin(object() if lacking == "_channel" else Lacking(), *rest),
    )
    call = begun(endpoint, endpoint._put)
    assert not isinstance(call, SingleThreadCall)
    call.send(b"abc")
    assert next(call).acks[0].items == 3
    call.cancel()
    endpoint.close()
