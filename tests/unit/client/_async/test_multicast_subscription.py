"""A reader of datagrams. The test plays the host: its stream, its datagrams and its connection."""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections import deque
from collections.abc import AsyncIterator, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from stampede_rt._async import multicast_subscription as module
from stampede_rt._async.multicast_subscription import MulticastSubscription
from stampede_rt._async.stream_reconnector import StreamReconnector
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import Unavailable
from stampede_rt.multicast.encryption import Encryptor, Signer
from stampede_rt.multicast.layout import KEY_BYTES, MessageKind, MulticastMessage, parts_of
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.long_answers import SubscribeAnswer

STREAM_ID, KEY = b"stream-1", bytes(KEY_BYTES)
SIGNER, ENCRYPTOR = Signer(STREAM_ID, bytes(KEY_BYTES)), Encryptor(STREAM_ID, 1, KEY)
OFFER = pb.MulticastOffer(
    group="239.1.2.3:7000", stream_id=STREAM_ID, key_number=1, key=KEY, public_key=SIGNER.public_key
)
BINDING = Binding(subject_id=b"c" * 16, target="host:1", epoch=3, incarnation=5)


def response_of(first_seq: int, end_seq: int, size: int = 1) -> pb.SubscribeResponse:
    runs = [
        item_pb2.DeliveredRun(
            run=item_pb2.ItemRun(time_unix_nano=[seq], payload_length_bytes=[size], payloads=bytes(size), first_seq=seq)
        )
        for seq in range(first_seq, end_seq)
    ]
    return pb.SubscribeResponse(runs=runs)


def gap_of(first_seq: int, last_seq: int) -> pb.SubscribeResponse:
    gap = pb.SubscriptionGap(first_seq=first_seq, last_seq=last_seq, items=last_seq + 1 - first_seq)
    return pb.SubscribeResponse(gap=gap)


def datagrams_of(first_seq: int, end_seq: int) -> list[bytes]:
    body = response_of(first_seq, end_seq).SerializeToString()
    message = SIGNER.sign(MulticastMessage(MessageKind.ITEMS, first_seq, end_seq, body))
    return [ENCRYPTOR.encrypt(part) for part in parts_of(message)]


class Stream:
    """The host's end of a stream, and the socket of the group. `answers`: the responses to the next request."""

    def __init__(self) -> None:
        cursor = pb.SubscriptionCursor(incarnation=5, next_seq=1)
        opened = pb.SubscriptionOpened(incarnation=5, next_seq=1)
        self.responses = deque([pb.SubscribeResponse(opened=opened, cursor=cursor, multicast=OFFER)])
        self.answers = list[pb.SubscribeResponse]()
        self.requests = list[pb.SubscribeRequest]()
        self.arriving: Iterator[list[bytes]] = iter(())
        self.cancelled = False

    async def send(self, request: pb.SubscribeRequest) -> None:
        self.requests.append(request)
        if request.HasField("open") and not request.open.multicast:
            self.responses[0].ClearField("multicast")
        if request.HasField("repair_next_seq") and self.answers:
            self.responses += self.answers
            self.responses[-1].repair_next_seq = request.repair_next_seq

    async def __aiter__(self) -> AsyncIterator[SubscribeAnswer]:
        while not self.cancelled:
            while not self.responses:
                await asyncio.sleep(0)
            yield SubscribeAnswer(self.responses.popleft(), [])

    def cancel(self) -> None:
        self.cancelled = True

    def poll(self) -> list[bytes]:
        return next(self.arriving, [])

    async def wait(self, timeout_s: float) -> None:
        await asyncio.sleep(0)

    def close(self) -> None:
        pass


class Session:
    """The connection. It makes another stream at each opening."""

    def __init__(self) -> None:
        self.streams = list[Stream]()
        self.closed = self.closing = False
        self.state = ""
        self.endpoints = self.subscribe = self

    def to(self, target: str) -> Session:
        return self

    def open_read_bidi(self, method: object) -> Stream:
        self.streams.append(Stream())
        return self.streams[-1]

    async def perform(self, state: object, operation: Any, timeout_s: float) -> None:
        if self.closed:
            raise Unavailable("the connection is closed")
        await operation(BINDING, timeout_s)

    def check_process(self) -> None:
        pass

    check_thread = check_process


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> Session:
    made = Session()
    monkeypatch.setattr(module, "join_group", lambda group, target: None)
    monkeypatch.setattr(module, "GroupSocket", lambda joined: made.streams[-1])
    return made


def subscription_of(session: Session) -> MulticastSubscription:
    def decoder(incarnation: int, *, payloads: bool) -> ItemDecoder:
        return ItemDecoder(incarnation=incarnation, content_type="", payloads=payloads)

    state = SimpleNamespace(info=SimpleNamespace(name="a", channel_id=b"c" * 16), decoder=decoder)
    reconnecting = StreamReconnector(cast(Any, session), "the subscription", "1s")
    begun = pb.SubscribeOpen(mode=pb.SUBSCRIBE_MODE_ALL)
    return MulticastSubscription(cast(Any, session), cast(Any, state), begun, reconnecting)


async def followed(session: Session) -> tuple[MulticastSubscription, Stream]:
    """A subscription whose items come from datagrams."""
    made = subscription_of(session)
    await made._open()
    made._is_following = True
    return made, session.streams[-1]


async def repaired(subscription: MulticastSubscription) -> list[int]:
    """Let the reader ask for a repair. Returns the seqs of the items that the reader has then."""
    assert subscription._receiving is not None
    await subscription._repair(subscription._receiving)
    seqs = [item.seq for item in subscription._ready.take_all()]
    return seqs


async def test_a_gap_that_ends_inside_a_held_message_counts_all_items_that_never_came(session: Session) -> None:
    subscription, stream = await followed(session)
    assert subscription._receiving is not None
    subscription._receiving.take(datagrams_of(5, 20), 0.0)
    stream.answers = [gap_of(1, 5)]
    assert (await repaired(subscription), subscription.dropped) == ([*range(5, 20)], 4)


async def test_a_gap_that_the_host_reports_again_is_counted_once(session: Session) -> None:
    subscription, stream = await followed(session)
    stream.responses.append(gap_of(1, 5))  # under way when the reader asks
    stream.answers = [gap_of(1, 7)]
    assert (await repaired(subscription), subscription.dropped) == ([], 7)


async def test_a_reader_learns_the_size_of_items_that_come_only_over_the_stream(session: Session) -> None:
    subscription, stream = await followed(session)
    assert subscription._receiving is not None
    subscription._receiving.merge.announce(1000)
    for seq in range(1, 30):
        stream.answers = [response_of(seq, seq + 1, 10_000)]
        assert await repaired(subscription) == [seq]
    assert stream.requests[-1].credit_bytes > 100_000


async def test_a_step_that_is_cancelled_during_the_joining_ends_the_stream(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def cancelled(operation: object) -> None:
        raise asyncio.CancelledError

    with monkeypatch.context() as patched:
        patched.setattr(module, "in_thread", cancelled)
        subscription = subscription_of(session)
        with pytest.raises(asyncio.CancelledError):
            await subscription._open()
    assert session.streams[0].cancelled
    await subscription._open()
    assert (len(session.streams), subscription._receiving is None) == (2, False)


async def test_a_step_that_is_cancelled_during_a_repair_ends_the_stream(session: Session) -> None:
    subscription, stream = await followed(session)
    asking = asyncio.create_task(repaired(subscription))
    while not any(request.HasField("repair_next_seq") for request in stream.requests):
        await asyncio.sleep(0)
    asking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await asking
    assert (stream.cancelled, subscription._receiving) == (True, None)


async def test_other_tasks_run_even_if_datagrams_arrive_as_fast_as_the_reader_takes_them(
    session: Session,
) -> None:
    subscription, stream = await followed(session)
    stream.arriving = (datagrams_of(seq, seq + 1) for seq in range(1, 101))
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    task = asyncio.create_task(other())
    assert [(await anext(subscription)).seq for _ in range(100)] == [*range(1, 101)]
    task.cancel()
    assert turns >= 99


async def test_a_reader_that_has_left_multicast_tries_it_again_after_a_time(session: Session) -> None:
    subscription, _ = await followed(session)
    subscription._leave()
    await subscription._open()
    session.streams[1].responses.append(pb.SubscribeResponse())
    await subscription._advance()
    assert (len(session.streams), subscription._receiving) == (2, None)
    subscription._no_multicast_before_s = 0.0
    advancing = asyncio.create_task(subscription._advance())
    while subscription._receiving is None:
        await asyncio.sleep(0)
    advancing.cancel()
    assert [stream.requests[0].open.multicast for stream in session.streams] == [True, False, True]
    assert subscription._retry_pause_s == 2 * module.RETRY_PAUSE_S


async def test_a_reader_ends_with_its_connection_although_datagrams_still_come(session: Session) -> None:
    subscription, stream = await followed(session)
    stream.arriving = (datagrams_of(seq, seq + 1) for seq in range(1, 101))
    assert (await anext(subscription)).seq == 1
    session.closed = True
    with pytest.raises(Unavailable):
        await anext(subscription)


async def test_a_dropped_subscription_is_freed_without_the_garbage_collector(session: Session) -> None:
    subscription, _ = await followed(session)
    alive = weakref.ref(subscription)
    gc.collect()
    gc.disable()
    try:
        del subscription
        assert alive() is None
    finally:
        gc.enable()
