"""The streams between members: one at a time from a member to another, without the messages of an earlier stream.

A refusal that repeats is logged once.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
import grpc.aio
import pytest

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt.v1 import raft_service_pb2_grpc
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.network.hello import OLDER_STORE, introduction
from stampede_rt_supernode.replication.network.peer_link import PeerLink
from stampede_rt_supernode.replication.network.reports import ReportLimiter
from stampede_rt_supernode.replication.network.servicer import RaftServicer
from stampede_rt_supernode.replication.raft_replica import MemberRoster
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, RaftTiming, ReplicationSettings
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.store import Promise
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    MessageReceived,
    NetworkEvent,
    StreamEnded,
    StreamOpened,
)
from stampede_rt_supernode.replication.wire.codec import encode_message
from stampede_rt_supernode.replication.wire.messages import TimeoutNow

SELF, OTHER = (Member(member_id=name, address=f"{name}:1") for name in ("self", "other"))
ROSTER = MemberRoster((SELF, OTHER), {"other": OTHER}, frozenset())
# The generated names carry no types.
_pb_grpc: Any = raft_service_pb2_grpc


def settings_of(member: Member, **more: Any) -> ReplicationSettings:
    return ReplicationSettings(self_member=member, initial_members=[SELF, OTHER], cluster_id="c", **more)


def hello_to(to: str, settings: ReplicationSettings) -> pb.RaftHello:
    return introduction(settings, to, store_id="", durable_end=(0, 0), roster=ROSTER, highest_level=1)


def timeout_now(term: int) -> pb.RaftMessage:
    """A message that the tests recognise by its term."""
    return encode_message(TimeoutNow(term=term))


class Inbox:
    """Stands for a `RaftReplica`, on the event loop of the test. Keeps the events that it gets."""

    roster = ROSTER
    feature_level = 1

    def __init__(self) -> None:
        self.events: list[NetworkEvent] = []
        self.promise = Promise(0, 0)
        self._changed = asyncio.Event()

    def deliver(self, event: NetworkEvent) -> None:
        self.events.append(event)
        self._changed.set()

    async def wait_for(self, kind: type[NetworkEvent]) -> None:
        """Wait for an event of that kind."""
        while not any(isinstance(event, kind) for event in self.events):
            self._changed.clear()
            await self._changed.wait()

    def promise_of(self, member_id: str) -> Promise:
        return self.promise


async def served(add: Callable[[grpc.aio.Server], None]) -> tuple[grpc.aio.Server, str]:
    server = grpc.aio.server()
    port = server.add_insecure_port("127.0.0.1:0")
    add(server)
    await server.start()
    return server, f"127.0.0.1:{port}"


async def opened_stream(channel: grpc.aio.Channel) -> Any:
    call = _pb_grpc.RaftServiceStub(channel).Exchange()
    await call.write(pb.RaftServiceExchangeRequest(hello=hello_to("self", settings_of(OTHER))))
    assert (await call.read()).protocol_version == PROTOCOL_VERSION
    return call


async def test_a_members_stream_ends_when_a_newer_one_replaces_it() -> None:
    inbox = Inbox()
    stores = await asyncio.to_thread(KnownStores.open, None, had_store=False)
    servicer = RaftServicer(settings_of(SELF), inbox, stores)  # type: ignore[arg-type]  # has the needed methods
    server, address = await served(servicer.add_to_server)
    async with grpc.aio.insecure_channel(address) as channel, asyncio.timeout(45):
        old = await opened_stream(channel)
        new = await opened_stream(channel)
        assert await old.code() is grpc.StatusCode.UNAVAILABLE
        await new.write(pb.RaftServiceExchangeRequest(messages=[timeout_now(7)]))
        await inbox.wait_for(MessageReceived)
        new.cancel()
        await inbox.wait_for(StreamEnded)
    await server.stop(None)
    kinds = [type(event) for event in inbox.events]
    assert kinds == [StreamOpened, StreamOpened, MessageReceived, StreamEnded]


async def greeted_by_an_older_copy(channel: grpc.aio.Channel) -> str:
    """Call as OTHER, with a store that lacks entries of OTHER's promise. Returns the text of the refusal."""
    call = _pb_grpc.RaftServiceStub(channel).Exchange()
    hello = hello_to("self", settings_of(OTHER))
    hello.store_id = "one"
    await call.write(pb.RaftServiceExchangeRequest(hello=hello))
    assert await call.code() is grpc.StatusCode.PERMISSION_DENIED
    return str(await call.details())


async def test_a_refused_copy_of_a_connected_member_is_logged_once_and_does_not_harm_the_member(
    caplog: pytest.LogCaptureFixture,
) -> None:
    inbox = Inbox()
    stores = await asyncio.to_thread(KnownStores.open, None, had_store=False)
    servicer = RaftServicer(settings_of(SELF), inbox, stores)  # type: ignore[arg-type]  # has the needed methods
    server, address = await served(servicer.add_to_server)
    async with grpc.aio.insecure_channel(address) as channel, asyncio.timeout(45):
        call = await opened_stream(channel)
        answers = set()
        for promised in (7, 8, 9):
            inbox.promise = Promise(1, promised)
            answers.add(await greeted_by_an_older_copy(channel))
        await call.write(pb.RaftServiceExchangeRequest(messages=[timeout_now(7)]))
        await inbox.wait_for(MessageReceived)
        call.cancel()
        await inbox.wait_for(StreamEnded)
        assert servicer.refused() == {}
        # While OTHER has no stream, such a caller may be OTHER itself. So its store counts as refused.
        await greeted_by_an_older_copy(channel)
        assert list(servicer.refused()) == ["other"]
    await server.stop(None)
    assert len(answers) == 3
    beside, alone = [record.getMessage() for record in caplog.records if "older copy" in record.getMessage()]
    assert "a copy of its folder: stop the copy" in beside
    assert "stampede supernode remove" in alone


class Peer(_pb_grpc.RaftServiceServicer):  # type: ignore[misc]
    """Stands for the other member: notes the terms that each stream brings."""

    def __init__(self) -> None:
        self.streams: list[list[int]] = []
        self.received_second = asyncio.Event()

    async def Exchange(  # noqa: N802
        self, requests: Any, context: Any
    ) -> AsyncIterator[pb.RaftServiceExchangeResponse]:
        numbers: list[int] = []
        self.streams.append(numbers)
        async for request in requests:
            if request.HasField("hello"):
                yield pb.RaftServiceExchangeResponse(protocol_version=PROTOCOL_VERSION)
            numbers += [message.timeout_now.term for message in request.messages]
            if 2 in numbers:
                self.received_second.set()


async def test_messages_that_wait_on_a_broken_stream_are_not_sent_on_the_next_one() -> None:
    peer = Peer()
    server, address = await served(lambda server: _pb_grpc.add_RaftServiceServicer_to_server(peer, server))
    # The queue has room for two messages. So the third message ends the first stream while the two still wait.
    room = 2 * timeout_now(1).ByteSize()
    settings = settings_of(SELF, link_queue_bytes_max=room, timing=RaftTiming(reconnect_seconds=0.01))
    connections = 0

    def deliver(event: NetworkEvent) -> None:
        nonlocal connections
        if isinstance(event, LinkConnected):
            connections += 1
            for term in (1, 1, 1) if connections == 1 else (2,):
                link.enqueue(timeout_now(term))

    link = PeerLink(
        OTHER,
        settings,
        lambda _: grpc.aio.insecure_channel(address),
        deliver,
        lambda why: None,
        lambda to: hello_to(to, settings),
        ReportLimiter(),
    )
    running = asyncio.create_task(link.run())
    async with asyncio.timeout(45):
        await peer.received_second.wait()
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    await server.stop(None)
    assert peer.streams == [[], [2]]


def test_a_refusal_with_changing_log_positions_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    unused: Any = None
    link = PeerLink(OTHER, settings_of(SELF), unused, unused, unused, unused, ReportLimiter())
    for entry in (7, 8, 9):
        link._report(
            f"PERMISSION_DENIED: 'self' {OLDER_STORE}: it held term 1 and entry {entry} before, and holds 1 and 1 now"
        )
    link._report("UNAVAILABLE: nobody there")
    assert [record.getMessage().count("entry 7") for record in caplog.records] == [1, 0]
