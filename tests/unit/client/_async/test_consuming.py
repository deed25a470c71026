"""How a connection keeps its places as a consumer: renewed in the background, given up at the end."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.consuming import SEQS_MAX, consume
from stampede_rt.cluster.binding import Binding
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import ChannelInfo, Policy

LEASE_NANOS = 15_000_000
BINDING = Binding(subject_id=b"c" * 16, target="host:1", epoch=3, incarnation=7)
INFO = ChannelInfo(
    channel_id=b"c" * 16, name="a", host_id=b"h" * 16, host="h1", host_alive=True, epoch=3, incarnation=7,
    policy=Policy(consumers=1), spec_version=1,
)  # fmt: skip


class FakeHost:
    """Answers Consume as the test says, and keeps the requests."""

    def __init__(self) -> None:
        self.requests: list[pb.ConsumeRequest] = []
        self.refusals: list[st.StampedeError] = []
        self.called = asyncio.Event()
        self.channels = self
        self.Consume = "Consume"

    async def call(self, method: str, request: pb.ConsumeRequest, timeout_s: float) -> pb.ConsumeResponse:
        assert method == self.Consume
        self.requests.append(request)
        self.called.set()
        if self.refusals:
            raise self.refusals.pop(0)
        return pb.ConsumeResponse(consumed=len(request.seqs), lease_nanos=LEASE_NANOS)

    async def next_call(self, condition: Callable[[pb.ConsumeRequest], bool] = lambda request: True) -> None:
        async with asyncio.timeout(45):
            while True:
                self.called.clear()
                await self.called.wait()
                if condition(self.requests[-1]):
                    return


class FakeSession:
    """The parts of a session that consuming uses."""

    def __init__(self) -> None:
        self.host = FakeHost()
        self.consumer_id = 99
        self.consumer_places: dict[bytes, Any] = {}
        self.attached: list[Any] = []
        self.closed = False
        self.detached = asyncio.Event()
        self.endpoints = self

    def to(self, target: str) -> FakeHost:
        return self.host

    async def perform(
        self, state: ChannelState, operation: Callable[[Binding, float], Awaitable[Any]], timeout_s: float
    ) -> Any:
        return await operation(BINDING, timeout_s)

    def attach(self, one: Any) -> None:
        self.attached.append(one)

    def detach(self, one: Any) -> None:
        self.attached.remove(one)
        self.detached.set()


@pytest.fixture
def session() -> Any:
    return FakeSession()


@pytest.fixture
def state() -> ChannelState:
    return ChannelState(INFO, Policy(), create=True)


def items(*seqs: int, incarnation: int = 7) -> list[st.Item]:
    return [st.Item(seq, None, None, seq, b"", {}, "", 0, incarnation) for seq in seqs]


async def test_a_consumer_place_is_renewed_until_the_connection_is_closed_without_consuming_items(
    session: Any, state: ChannelState
) -> None:
    assert await consume(session, state, items(1, 2)) == 2
    first = session.host.requests[0]
    assert (first.consumer_id, first.epoch, first.incarnation, list(first.seqs)) == (99, 3, 7, [1, 2])
    for _ in range(3):
        await session.host.next_call()
        renewal = session.host.requests[-1]
        assert (renewal.consumer_id, list(renewal.seqs), renewal.HasField("lease_nanos")) == (99, [], False)
    (kept,) = session.attached
    await kept.end()
    assert session.host.requests[-1].lease_nanos == 0
    assert session.host.requests[-1].HasField("lease_nanos")


async def test_several_handles_of_a_channel_share_one_consumer_place(session: Any, state: ChannelState) -> None:
    await consume(session, state, [])
    await consume(session, ChannelState(INFO, Policy(), create=False), items(1))
    assert len(session.attached) == len(session.consumer_places) == 1
    await session.attached[0].end()


async def test_a_renewal_that_fails_for_a_while_is_tried_again(session: Any, state: ChannelState) -> None:
    await consume(session, state, [])
    session.host.refusals = [st.Unavailable("away"), st.DeadlineExceeded("slow")]
    for _ in range(3):
        await session.host.next_call()
    assert session.attached
    await session.attached[0].end()


async def test_a_lost_consumer_place_is_not_renewed_and_can_be_taken_again(session: Any, state: ChannelState) -> None:
    await consume(session, state, [])
    session.host.refusals = [st.ChannelFull("all places are taken")]
    async with asyncio.timeout(45):
        await session.detached.wait()
    assert not session.consumer_places
    await consume(session, state, [])
    assert session.attached
    await session.attached[0].end()


async def test_a_connection_closes_without_waiting_for_a_lost_host(session: Any, state: ChannelState) -> None:
    await consume(session, state, [])
    session.host.refusals = [st.Unavailable("gone") for _ in range(10)]
    await session.attached[0].end()


async def test_many_consumed_items_are_sent_in_requests_within_the_limit_of_hosts(
    session: Any, state: ChannelState
) -> None:
    assert await consume(session, state, items(*range(1, SEQS_MAX + 3))) == SEQS_MAX + 2
    assert [len(request.seqs) for request in session.host.requests] == [SEQS_MAX, 2]
    await session.attached[0].end()


async def test_consumed_items_of_two_incarnations_are_kept_apart(session: Any, state: ChannelState) -> None:
    await consume(session, state, [*items(1), *items(2, incarnation=8), *items(3)])
    acks = [(request.incarnation, list(request.seqs)) for request in session.host.requests]
    assert acks == [(7, [1, 3]), (8, [2])]
    await session.attached[0].end()


async def test_consume_accepts_only_items(session: Any, state: ChannelState) -> None:
    with pytest.raises(st.InvalidArgument, match="give items"):
        await consume(session, state, [b"payload"])  # type: ignore[list-item]
    assert not session.host.requests
