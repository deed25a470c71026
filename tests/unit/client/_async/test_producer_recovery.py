"""The producer against a stream that a test plays: acks, refusals and ends in orders that a real host seldom shows."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any, cast

import pytest

import stampede_rt as st
from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.producer import IN_FLIGHT_RUNS_MAX, Producer
from stampede_rt._async.session import Session
from stampede_rt.cluster.binding import Binding, BindingCache
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.wire.batching import REQUEST_RUNS_MAX
from stampede_rt.wire.request_pieces import JOINED_BYTES_MAX
from stampede_rt_channel_host.core.dedup import RetryWindow
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart

LIMIT_S = 5.0


class Duplex:
    """A stream that keeps its requests."""

    def __init__(self, on_response: Any, on_end: Any) -> None:
        self.on_response, self.on_end = on_response, on_end
        self.sent: list[pb.PutRequest] = []

    def send(self, request: bytes | list[bytes]) -> None:
        self.sent.append(pb.PutRequest.FromString(b"".join(request) if isinstance(request, list) else request))

    @property
    def numbers(self) -> list[int]:
        """The first numbers of the runs, in the order of their coming."""
        return [put.first_number for request in self.sent for put in request.puts]

    @property
    def items(self) -> int:
        """The number of items that came."""
        return sum(len(put.run.payload_length_bytes) for request in self.sent for put in request.puts)

    def cancel(self) -> None:
        pass


class Place:
    """A session whose channel is always at one place; every stream opened there is kept."""

    closed = False
    inherited = False
    here = None

    def check_process(self) -> None:
        return

    def __init__(self) -> None:
        self.cache = BindingCache()
        self.endpoints = self
        self.found = asyncio.Event()  # set when the place of the channel is known
        self.found.set()
        self.streams: list[Duplex] = []
        self.opened = asyncio.Event()

    def to(self, target: str) -> Place:
        return self

    def duplex(self, on_response: Any, on_end: Any) -> Duplex:
        self.streams.append(Duplex(on_response, on_end))
        self.opened.set()
        return self.streams[-1]

    async def perform(self, state: ChannelState, operation: Any, timeout_s: float = 10.0) -> Any:
        await self.found.wait()
        return await operation(Binding(subject_id=b"c", target="there", epoch=1, incarnation=1), timeout_s)


def producer_at(place: Place) -> Producer:
    info = ChannelInfo.__new__(ChannelInfo)
    object.__setattr__(info, "channel_id", b"c")
    object.__setattr__(info, "name", "cam/left")
    return Producer(cast(Session, place), ChannelState(info, cast(Policy, None), True))


def accepted(first_number: int) -> pb.PutAck:
    return pb.PutAck(first_number=first_number, items=1)


def moved(first_number: int) -> pb.PutAck:
    error = to_error_message(st.Unavailable("elsewhere", reason="MOVED"))
    return pb.PutAck(first_number=first_number, items=1, error=error)


async def three_in_flight(place: Place) -> Producer:
    producer = producer_at(place)
    for number in range(1, 4):
        await producer.put(b"%d" % number)
        await producer._send_all()
    assert place.streams[0].numbers == [1, 2, 3]
    return producer


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def test_one_message_with_several_refusals_wakes_a_flush_that_waits() -> None:
    place = Place()
    producer = await three_in_flight(place)
    place.opened.clear()
    flush = asyncio.ensure_future(producer.flush(LIMIT_S))
    await settled()
    await place.streams[0].on_response(pb.PutResponse(acks=[moved(1), moved(2), moved(3)]))
    await asyncio.wait_for(place.opened.wait(), LIMIT_S / 2)
    await settled()
    assert place.streams[1].numbers == [1, 2, 3]
    await place.streams[1].on_response(pb.PutResponse(acks=[accepted(1), accepted(2), accepted(3)]))
    await flush
    assert producer.accepted == 3


async def test_a_put_to_a_host_that_does_not_answer_ends_at_its_timeout() -> None:
    """The host's process lives, so the connection lives, too; its event loop hangs."""
    place = Place()
    producer = await three_in_flight(place)
    for _ in range(IN_FLIGHT_RUNS_MAX - 3):
        await producer.put(b"more")
        await producer._send_all()
    while producer._builder.has_room(2**20):
        await producer.put(bytes(2**20))
    handed_over = len(producer._builder)
    with pytest.raises(st.DeadlineExceeded, match=f"did not acknowledge {IN_FLIGHT_RUNS_MAX} runs .* is overloaded"):
        await producer.put(bytes(2**20), timeout=0.01)
    assert len(producer._builder) == handed_over
    assert len(place.streams) == 1


async def test_unacknowledged_runs_are_sent_again_before_newer_runs() -> None:
    place = Place()
    producer = await three_in_flight(place)
    await producer.put(b"4")
    await place.streams[0].on_end(st.Unavailable("broken"))
    flush = asyncio.ensure_future(producer.flush(LIMIT_S))
    await settled()
    await asyncio.wait_for(_streams(place, 2), LIMIT_S / 2)
    stream = place.streams[1]
    await stream.on_response(pb.PutResponse(acks=[accepted(1)]))
    assert stream.numbers == [1, 2, 3, 4]
    await stream.on_response(pb.PutResponse(acks=[accepted(number) for number in (2, 3, 4)]))
    await flush
    assert producer.accepted == 4


async def _streams(place: Place, count: int) -> None:
    while len(place.streams) < count:
        place.opened.clear()
        await place.opened.wait()


@pytest.mark.parametrize("unacked", [0, 1], ids=["the first stream", "a later one"])
async def test_a_put_that_is_cancelled_while_its_stream_opens_sends_nothing_and_disturbs_no_other_put(
    unacked: int,
) -> None:
    """In an earlier version, the host rejected all later puts on the stream, because it had not received the first
    message.
    """
    place = Place()
    producer = producer_at(place)
    for _ in range(unacked):
        await producer.put(b"1")
        await place.streams[0].on_end(st.Unavailable("broken"))
    place.found.clear()
    put = asyncio.ensure_future(producer.put(b"cancelled"))
    await settled()
    put.cancel()
    with pytest.raises(asyncio.CancelledError):
        await put
    place.found.set()
    await producer.put(b"next")
    await producer._send_all()
    stream = place.streams[-1]
    assert stream.sent[0].channel_id == b"c"
    assert stream.numbers == list(range(1, unacked + 2))
    assert b"cancelled" not in b"".join(put.run.payloads for sent in stream.sent for put in sent.puts)


async def test_the_next_call_after_a_final_failure_sends_the_unacknowledged_runs() -> None:
    """In an earlier version, every later call reported the failure, and the client never sent runs without an ack
    again.
    """
    place = Place()
    producer = await three_in_flight(place)
    await place.streams[0].on_end(st.StampedeError("the host failed with a defect"))
    with pytest.raises(st.StampedeError, match="a defect"):
        await producer.flush(LIMIT_S)
    flush = asyncio.ensure_future(producer.flush(LIMIT_S))
    await settled()
    await place.streams[1].on_response(pb.PutResponse(acks=[accepted(1), accepted(2), accepted(3)]))
    await flush
    assert producer.accepted == 3


async def test_a_producer_without_room_opens_a_new_stream_after_a_final_failure() -> None:
    place = Place()
    producer = producer_at(place)
    while producer._has_room():
        await producer.put(b"x")
        producer._send_filled()
    await place.streams[0].on_end(st.StampedeError("the host failed with a defect"))
    with pytest.raises(st.StampedeError, match="a defect"):
        await producer.flush(LIMIT_S)
    flush = asyncio.ensure_future(producer.flush(LIMIT_S))
    await settled()
    assert len(place.streams) == 2
    sent = place.streams[1].numbers
    await place.streams[1].on_response(pb.PutResponse(acks=[accepted(number) for number in sent]))
    await flush
    assert producer.accepted == IN_FLIGHT_RUNS_MAX


async def test_an_ack_of_a_stream_that_was_given_up_counts_for_nothing() -> None:
    place = Place()
    producer = await three_in_flight(place)
    await place.streams[0].on_end(st.Unavailable("broken"))
    await producer._send_all()
    await place.streams[0].on_response(pb.PutResponse(acks=[accepted(1)]))
    assert producer.accepted == 0
    assert place.streams[1].numbers == [1, 2, 3]


async def test_the_timeout_of_a_flush_holds_while_all_room_is_taken() -> None:
    place = Place()
    producer = producer_at(place)
    for _ in itertools.takewhile(lambda _: producer._has_room(), itertools.count()):
        await producer.put(b"x")
        producer._send_filled()
    await producer.put(b"one more")
    async with asyncio.timeout(LIMIT_S):
        with pytest.raises(st.DeadlineExceeded, match="64 runs"):
            await producer.flush(0.01)


def test_the_retry_window_of_a_host_covers_all_runs_that_a_producer_may_send_again() -> None:
    """The client's bound on runs in flight and the host's window belong together."""
    from stampede_rt._async.producer import IN_FLIGHT_RUNS_MAX
    from stampede_rt.wire.delivered import RUN_ITEMS_MAX

    window = RetryWindow()
    for run in range(IN_FLIGHT_RUNS_MAX):
        first = 1 + run * RUN_ITEMS_MAX
        part = RunPart(0, first, RUN_ITEMS_MAX, None)
        window.record(7, first, RunOutcome(RUN_ITEMS_MAX, RUN_ITEMS_MAX, (part,), (), 0))
    known = window.find(7, 1, RUN_ITEMS_MAX, now=1)
    assert known is not None
    assert known.first_seq == 1


async def test_runs_that_gather_while_one_waits_for_its_ack_are_sent_together() -> None:
    place = Place()
    producer = producer_at(place)
    for number in range(60):
        await producer.put(bytes(18_000), attributes={"n": str(number)})  # each is a run of its own
    sizes = [len(request.puts) for request in place.streams[0].sent[1:]]
    assert sizes[0] == 1, "the first item did not wait"
    assert set(sizes[1:]) == {REQUEST_RUNS_MAX}
    assert all(request.ByteSize() <= JOINED_BYTES_MAX for request in place.streams[0].sent)
    sent = place.streams[0].numbers
    await place.streams[0].on_response(pb.PutResponse(acks=[accepted(number) for number in sent]))
    runs, items = [len(request.puts) for request in place.streams[0].sent], place.streams[0].items
    assert runs[-1] > 1, "the rest went out together once nothing was under way"
    assert items == 60


async def test_large_items_are_joined_up_to_a_mebibyte_and_larger_ones_are_sent_separately() -> None:
    place = Place()
    producer = producer_at(place)
    for size in [300_000] * 7 + [JOINED_BYTES_MAX, 5]:
        await producer.put(bytes(size))
    await producer._send_all()
    assert [len(request.puts) for request in place.streams[0].sent[1:]] == [1, 3, 3, 1, 1]
    assert place.streams[0].items == 9


async def test_medium_items_fill_runs_which_fill_a_request() -> None:
    place = Place()
    producer = producer_at(place)
    for _ in range(180):
        await producer.put(bytes(18_000))
    full = place.streams[0].sent[2:]
    assert {len(request.puts) for request in full} == {4}
    assert {len(put.run.payload_length_bytes) for request in full for put in request.puts} == {12}
    assert all(request.ByteSize() <= JOINED_BYTES_MAX for request in full)


async def test_a_request_has_a_bounded_number_of_runs() -> None:
    place = Place()
    producer = producer_at(place)
    for number in range(60):
        await producer.put(b"x", attributes={"n": str(number)})
    await producer._send_all()
    assert [len(request.puts) for request in place.streams[0].sent[1:]] == [1, *[REQUEST_RUNS_MAX] * 3, 11]


async def test_a_producer_sends_all_its_runs_in_order_in_full_requests_after_a_break() -> None:
    place = Place()
    producer = producer_at(place)
    for number in range(50):
        await producer.put(bytes(18_000), attributes={"n": str(number)})  # each is a run of its own
    await place.streams[0].on_end(st.Unavailable("broken"))
    await producer._send_all()
    runs = [len(request.puts) for request in place.streams[1].sent[1:]]
    assert runs[:3] == [REQUEST_RUNS_MAX] * 3
    assert place.streams[1].numbers == sorted(place.streams[1].numbers)
    assert place.streams[1].items == 50
