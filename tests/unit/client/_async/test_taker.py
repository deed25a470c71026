"""Taking from a queue that a test plays: credit, drains and streams that break, in orders a real host seldom shows."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

import stampede_rt as st
from stampede_rt._async.queue_locator import QueueLocator, QueueState
from stampede_rt._async.session import Session
from stampede_rt._async.taker import Taker
from stampede_rt.cluster.binding import BindingCache, Owner
from stampede_rt.v1 import item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt.values.queueing import QueueInfo, QueuePolicy
from stampede_rt.values.reading import Wait
from stampede_rt.wire.delivered import RUN_ITEMS_MAX

LIMIT_S = 5.0
FOR_EVER = Wait(None)
INFO = QueueInfo(
    queue_id=bytes(16), name="work", host_id=b"h", host="h", host_alive=True, epoch=3, incarnation=9,
    policy=QueuePolicy(), spec_version=1,
)  # fmt: skip


def run_of(*seqs: int) -> item_pb2.ItemRun:
    return item_pb2.ItemRun(
        time_unix_nano=seqs, payload_length_bytes=[1] * len(seqs), payloads=b"x" * len(seqs), first_seq=min(seqs)
    )


class Stream:
    """A Take stream. It keeps the requests, and gives the responses that the test states."""

    def __init__(self, opens: bool = True, error: st.StampedeError | None = None) -> None:
        self.opens = opens
        self.error = error
        self.sent_requests: list[pb.TakeRequest] = []
        self.answers: asyncio.Queue[pb.TakeResponse | st.StampedeError | None] = asyncio.Queue()
        self.has_request = asyncio.Event()

    async def send(self, request: pb.TakeRequest) -> None:
        self.sent_requests.append(request)
        if self.error is not None:
            self.answers.put_nowait(self.error)
        elif self.opens and request.HasField("open"):
            self.deliver()
        self.has_request.set()

    def cancel(self) -> None:
        self.answers.put_nowait(None)

    async def __aiter__(self) -> AsyncIterator[pb.TakeResponse]:
        while (answer := await self.answers.get()) is not None:
            if isinstance(answer, st.StampedeError):
                raise answer
            yield answer

    @property
    def credit(self) -> int:
        return sum(request.credit for request in self.sent_requests)

    def deliver(self, *seqs: int, drained: bool = False, lease_s: float = 30) -> None:
        parts = [seqs[at : at + RUN_ITEMS_MAX] for at in range(0, len(seqs), RUN_ITEMS_MAX)]
        runs = [
            queue_pb2.LeasedRun(run=run_of(*part), delivery_ids=part, lease_nanos=round(lease_s * 1e9))
            for part in parts
        ]
        self.answers.put_nowait(pb.TakeResponse(runs=runs, incarnation=9, drained=drained))


class FixedQueuePlace(BindingCache):
    """A queue whose place never changes."""

    def forget(self, channel_id: bytes) -> None:
        pass


class Host:
    """A session with one host. It keeps the streams and the returned messages."""

    closing = closed = False
    inherited = False

    def check_process(self) -> None:
        return

    def check(self) -> None:
        return

    def __init__(self) -> None:
        self.cache = FixedQueuePlace()
        self.endpoints = self
        self.queues = self
        self.streams: asyncio.Queue[Stream] = asyncio.Queue()
        self.opens = True
        self.error: st.StampedeError | None = None
        self.given_back: list[int] = []
        self.extended: list[int] = []
        self.settled = asyncio.Event()
        self.attached: list[object] = []
        self.Take, self.Settle = object(), object()
        self.cache.learn_owner(INFO.queue_id, Owner(host_id=b"h", epoch=3, spec_version=1, incarnation=9), ["h:1"])

    def to(self, target: str) -> Host:
        return self

    def open_bidi(self, method: Any) -> Stream:
        stream = Stream(self.opens, self.error)
        self.streams.put_nowait(stream)
        return stream

    async def call(self, method: Any, request: pb.SettleRequest, timeout_s: float) -> pb.SettleResponse:
        self.given_back += [one.delivery_id for one in request.settlements if one.HasField("give_back")]
        self.extended += [one.delivery_id for one in request.settlements if one.HasField("extend_lease")]
        self.settled.set()
        return pb.SettleResponse(results=[queue_pb2.SettlementResult() for _ in request.settlements])

    def attach(self, one: object) -> None:
        self.attached.append(one)

    def detach(self, one: object) -> None:
        if one in self.attached:
            self.attached.remove(one)

    async def next_stream(self) -> Stream:
        stream = await asyncio.wait_for(self.streams.get(), LIMIT_S)
        await asyncio.wait_for(stream.has_request.wait(), LIMIT_S)
        return stream


def taker_at(host: Host, prefetch: int = 1) -> Taker:
    session = cast(Session, host)
    state = QueueState("queue", "work", INFO, QueuePolicy(), create=True)
    return Taker(session, QueueLocator(session, state), state, prefetch)


async def until_sent(stream: Stream, wanted: Any) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not any(wanted(request) for request in stream.sent_requests):
            stream.has_request.clear()
            await stream.has_request.wait()


async def until_handed_over(taker: Taker) -> None:
    """Wait until a waiting caller has a message, before the caller runs on."""
    credit, waiting = taker._credit, len(taker._waiting)
    for _ in range(1000):
        if taker._credit < credit and len(taker._waiting) < waiting:
            return
        await asyncio.sleep(0)
    raise AssertionError("no waiting caller has got a message")


async def seq_of(get: Any) -> int:
    message = await asyncio.wait_for(get, LIMIT_S)
    assert message is not None
    return int(message.seq)


async def test_a_taker_asks_for_one_message_for_each_waiting_caller() -> None:
    host = Host()
    taker = taker_at(host)
    first = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    assert (stream.sent_requests[0].open.epoch, stream.credit) == (3, 1)
    second = asyncio.ensure_future(taker.get(FOR_EVER))
    await until_sent(stream, lambda request: request.credit and not request.HasField("open"))
    stream.deliver(1, 2)
    assert (await seq_of(first), await seq_of(second), stream.credit) == (1, 2, 2)
    await taker.end()
    assert host.attached == []


async def test_callers_beyond_the_credit_limit_are_served_after_the_others() -> None:
    """In an earlier version, the client asked the host for no message for the 1025th waiting caller.

    This caller waited for ever, although messages were available.
    """
    host = Host()
    taker = taker_at(host)
    gets = [asyncio.ensure_future(taker.get(FOR_EVER)) for _ in range(1026)]
    stream = await host.next_stream()
    assert stream.credit == 1024
    stream.deliver(*range(1, 1025))
    await until_sent(stream, lambda request: request.credit == 2)
    stream.deliver(1025, 1026)
    assert [await seq_of(get) for get in gets] == list(range(1, 1027))
    await taker.end()


async def test_a_message_that_comes_during_the_drain_still_belongs_to_the_ended_wait() -> None:
    host = Host()
    taker = taker_at(host)
    get = asyncio.ensure_future(taker.get(Wait(0)))
    stream = await host.next_stream()
    await until_sent(stream, lambda request: request.drain)
    assert stream.credit == 1
    stream.deliver(7, drained=True)
    assert await seq_of(get) == 7
    assert host.given_back == []


async def test_the_next_stream_serves_a_waiting_caller_after_the_drain_for_another_caller() -> None:
    host = Host()
    taker = taker_at(host)
    waiting = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    leaving = asyncio.ensure_future(taker.get(Wait(0)))
    await until_sent(stream, lambda request: request.drain)
    stream.deliver(drained=True)
    assert await asyncio.wait_for(leaving, LIMIT_S) is None
    stream = await host.next_stream()
    assert stream.credit == 1
    stream.deliver(1)
    assert await seq_of(waiting) == 1


async def test_a_message_that_arrives_while_its_wait_is_cancelled_is_given_back() -> None:
    host = Host()
    taker = taker_at(host)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    get.cancel()
    with pytest.raises(asyncio.CancelledError):
        await get
    await until_sent(stream, lambda request: request.drain)
    stream.deliver(5, drained=True)
    await asyncio.wait_for(host.settled.wait(), LIMIT_S)
    assert host.given_back == [5]


async def test_a_message_for_a_cancelled_getter_goes_to_the_next_getter_of_the_client() -> None:
    host = Host()
    taker = taker_at(host)
    first, second = (asyncio.ensure_future(taker.get(FOR_EVER)) for _ in range(2))
    stream = await host.next_stream()
    await until_sent(stream, lambda request: stream.credit == 2)
    stream.deliver(5)
    await until_handed_over(taker)  # the first getter has the message, and has not run on yet
    first.cancel()
    with pytest.raises(asyncio.CancelledError):
        await first
    assert await seq_of(second) == 5
    assert host.given_back == []


async def test_a_getter_that_is_cancelled_in_its_first_step_takes_nothing() -> None:
    """In an earlier version, the getter stayed in line.

    The next message was leased to it, and no caller got the message before that lease ended.
    """
    host = Host()
    taker = taker_at(host)
    held = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    await asyncio.sleep(0)
    get.cancel()
    with pytest.raises(asyncio.CancelledError):
        await get
    stream.deliver(1)
    assert await seq_of(held) == 1
    assert not taker._waiting


async def test_a_poll_returns_a_message_immediately_that_another_caller_had_asked_for() -> None:
    """In an earlier version, the poll already had its message, but waited 12 s for a stream on which to ask for another
    one.
    """
    host = Host()
    taker = taker_at(host)
    cancelled = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    cancelled.cancel()
    await until_sent(stream, lambda request: request.drain)
    poll = asyncio.ensure_future(taker.get(Wait(0)))
    await asyncio.sleep(0)
    stream.deliver(1, drained=True)
    assert await seq_of(poll) == 1


async def test_prefetched_messages_are_extended_while_the_program_takes_messages_and_given_back_otherwise() -> None:
    """In an earlier version, the leases of prefetched messages ended while their taker worked on the messages before
    them.
    """
    host = Host()
    taker = taker_at(host, prefetch=3)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    stream.deliver(1, 2, 3, lease_s=1)
    assert (await seq_of(get), await seq_of(taker.get(FOR_EVER))) == (1, 2)
    async with asyncio.timeout(LIMIT_S):
        while not host.given_back:
            await host.settled.wait()
            host.settled.clear()
    assert (host.extended, host.given_back) == ([3], [3])


async def test_waiting_callers_continue_after_a_break_of_their_stream() -> None:
    host = Host()
    taker = taker_at(host)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    stream.deliver()  # a sign of life
    stream.answers.put_nowait(st.Unavailable("the connection broke"))
    stream = await host.next_stream()
    assert stream.credit == 1
    stream.deliver(4)
    assert await seq_of(get) == 4


async def until_at_rest(taker: Taker) -> None:
    async with asyncio.timeout(LIMIT_S):
        while taker._worker is not None:
            await asyncio.sleep(0)


async def test_no_stream_is_opened_for_callers_that_left_meanwhile() -> None:
    """In an earlier version, after the loss of a host, each cancelled get of a handle left a stream and a task behind
    at the new host.
    """
    host = Host()
    host.error = st.Unavailable("connection refused")
    taker = taker_at(host)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    await host.next_stream()
    get.cancel()
    with pytest.raises(asyncio.CancelledError):
        await get
    host.error = None
    await until_at_rest(taker)
    assert host.attached == []


async def test_a_stream_that_opens_after_its_handle_was_closed_is_drained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stampede_rt._async.taker.END_TIMEOUT_S", 0.0)
    host = Host()
    host.opens = False
    taker = taker_at(host)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    await taker.end()
    assert await get is None
    stream.deliver()
    await until_sent(stream, lambda request: request.drain)
    stream.deliver(4, drained=True)
    await until_at_rest(taker)
    assert host.given_back == [4]


async def test_all_waiting_callers_get_the_error_that_their_queue_is_deleted() -> None:
    host = Host()
    taker = taker_at(host)
    gets = [asyncio.ensure_future(taker.get(FOR_EVER)) for _ in range(2)]
    for _ in range(2):  # the taker looks for the queue's name once
        (await host.next_stream()).answers.put_nowait(st.QueueNotFound("it was deleted"))
    for get in gets:
        with pytest.raises(st.QueueNotFound, match="queue 'work'"):
            await asyncio.wait_for(get, LIMIT_S)
    assert host.attached == []


async def test_a_taker_skips_prefetched_messages_whose_leases_have_ended() -> None:
    host = Host()
    taker = taker_at(host, prefetch=4)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    assert stream.credit == 4
    stream.deliver(1, 2, lease_s=0)
    stream.deliver(3)
    assert await seq_of(get) == 1
    assert await seq_of(taker.get(FOR_EVER)) == 3


async def test_prefetched_messages_are_given_back_at_the_end() -> None:
    host = Host()
    taker = taker_at(host, prefetch=4)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    stream.deliver(1, 2, 3)
    assert await seq_of(get) == 1
    ending = asyncio.ensure_future(taker.end())
    await until_sent(stream, lambda request: request.drain)
    stream.deliver(drained=True)
    await asyncio.wait_for(ending, LIMIT_S)
    assert host.given_back == [2, 3]
    with pytest.raises(st.InvalidArgument, match="closed"):
        await taker.get(FOR_EVER)


async def test_the_error_after_the_close_of_a_connection_names_the_connection_and_not_the_handle() -> None:
    host = Host()
    taker = taker_at(host)
    host.closing = True
    await taker.end()
    with pytest.raises(st.Unavailable, match="this connection is closed"):
        await taker.get(FOR_EVER)


async def test_a_taker_refuses_all_messages_of_a_host_that_sends_more_than_granted() -> None:
    host = Host()
    taker = taker_at(host, prefetch=8)
    get = asyncio.ensure_future(taker.get(FOR_EVER))
    stream = await host.next_stream()
    stream.deliver(*range(1, stream.credit + 2))
    with pytest.raises(st.StampedeError, match=r"a host sent 9 items, and the reader granted 8 at most"):
        await get
    assert len(taker._ready) == 0


async def test_a_run_whose_columns_disagree_ends_the_wait_with_a_reason() -> None:
    host = Host()
    get = asyncio.ensure_future(taker_at(host).get(FOR_EVER))
    stream = await host.next_stream()
    leased = queue_pb2.LeasedRun(run=run_of(1), delivery_ids=[1], deliveries=[1, 1], lease_nanos=10**9)
    stream.answers.put_nowait(pb.TakeResponse(runs=[leased], incarnation=9))
    with pytest.raises(st.StampedeError, match="a host sent a run with 1 items, 1 delivery ids and 2 counts"):
        await get
