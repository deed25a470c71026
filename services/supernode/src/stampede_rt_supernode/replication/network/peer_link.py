"""The stream to one other member: messages leave in order, at most once, without retries."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import grpc
import grpc.aio

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt.v1 import raft_service_pb2_grpc
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.network.hello import UNKNOWN, other_protocol
from stampede_rt_supernode.replication.network.refusals import grounds_of
from stampede_rt_supernode.replication.network.reports import ReportLimiter
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, ReplicationSettings
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    LinkDisconnected,
    MembersReported,
    NetworkEvent,
)
from stampede_rt_supernode.replication.wire.records import MalformedMessage, decode_members

logger = logging.getLogger(__name__)

# Makes a new channel to an address.
Dial = Callable[[str], grpc.aio.Channel]
# Makes the hello to a member, given the id of that member.
Introduce = Callable[[str], pb.RaftHello]

# A request has REQUEST_MESSAGES_MAX messages at most. The message that reaches REQUEST_BYTES ends it.
REQUEST_MESSAGES_MAX = 256
REQUEST_BYTES = 1 << 20
# How long the peer may take to answer the hello.
HELLO_SECONDS = 2.0
# At most this many characters of a reason are logged and remembered.
REASON_CHARACTERS_MAX = 500

# The options of a channel to a member. Without them gRPC waits up to two minutes before it tries a dead peer again, and
# channels with equal arguments share that wait.
CHANNEL_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 500),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.use_local_subchannel_pool", 1),
)

# The generated class has no types.
_stub_class: Any = raft_service_pb2_grpc.RaftServiceStub


class LinkBroken(Exception):
    """The stream ended, or this member ended it. The link opens a new stream after a pause."""


class PeerLink:
    """The stream to one member. All methods run on the loop. Other threads read only `queued_bytes`."""

    def __init__(
        self,
        member: Member,
        settings: ReplicationSettings,
        dial: Dial,
        deliver: Callable[[NetworkEvent], None],
        on_break: Callable[[str], None],
        introduce: Introduce,
        reports: ReportLimiter,
    ) -> None:
        """`on_break` gets the reason each time that the stream cannot be opened, or ends."""
        self._reports = reports
        self.member = self._member = member
        self._on_break = on_break
        self._introduce = introduce
        self._settings = settings
        self._dial = dial
        self._deliver = deliver
        self._queue: deque[tuple[pb.RaftMessage, int]] = deque()
        self.queued_bytes = 0
        # Whether the peer has accepted the hello of the present stream.
        self._open = False
        # True if the queue had no room for a message, so that the stream must end.
        self._overflow = False
        # When this member sent the first request since the peer's last answer, in the loop's time; None without one.
        self._unanswered_since: float | None = None
        # The members in the peer's latest list on this stream.
        self._members_of_peer: tuple[Member, ...] = ()
        # True if an empty request is due, so that the peer answers.
        self._probe_due = False
        # True if the stream must end, so that the next one begins with a new hello.
        self._greet_anew = False
        self._work = asyncio.Event()

    def greet_anew(self) -> None:
        """End the stream, if there is one. At the next stream's hello the peer decides again whether to accept it."""
        if self._open:
            self._greet_anew = True
            self._work.set()

    def enqueue(self, message: pb.RaftMessage) -> None:
        """Queue one message. Drops it if there is no stream, and ends the stream if its queue is full."""
        if not self._open:
            return
        size = message.ByteSize()
        if self.queued_bytes + size > self._settings.link_queue_bytes_max:
            self._overflow = True
        else:
            self._queue.append((message, size))
            self.queued_bytes += size
        self._work.set()

    async def run(self) -> None:
        """Keep the stream open until cancelled. Opens it again after each break."""
        pause = self._settings.timing.reconnect_seconds
        while True:
            try:
                await self._hold_stream()
            except (grpc.RpcError, LinkBroken, TimeoutError, asyncio.InvalidStateError) as error:
                self._report(_brief(error))
                self._on_break(_brief(error))
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))

    def _report(self, reason: str) -> None:
        """Log the reason why there is no stream, but the same reason at most once in ten minutes."""
        # Compares the grounds of a refusal, because its text may contain log positions, which differ each time.
        if self._reports.is_due((self._member.member_id, grounds_of(reason) or reason), time.monotonic()):
            level = logging.INFO if UNKNOWN in reason else logging.WARNING
            logger.log(
                level,
                "no link to member %s at %s: %s",
                self._member.member_id,
                self._member.address,
                reason,
                extra={"event": "no_member_link"},
            )

    async def _hold_stream(self) -> None:
        channel = self._dial(self._member.address)
        try:
            call = _stub_class(channel).Exchange()
            await self._greet(call)
            await self._pump(call)
        finally:
            await channel.close()

    async def _greet(self, call: Any) -> None:
        hello = self._introduce(self._member.member_id)
        async with asyncio.timeout(HELLO_SECONDS):
            await call.write(pb.RaftServiceExchangeRequest(hello=hello))
            answer = await call.read()
        if answer is grpc.aio.EOF:
            raise LinkBroken(f"refused: {await call.code()}: {await call.details()}")
        if answer.protocol_version != PROTOCOL_VERSION:
            raise LinkBroken(other_protocol(self._settings.self_member.member_id, answer.protocol_version))
        self._members_of_peer = ()
        self._take_members(answer)
        if answer.unknown_caller:
            await call.read()
            raise LinkBroken(f"refused: {await call.code()}: {await call.details()}")

    async def _pump(self, call: Any) -> None:
        self._open = True
        self._deliver(LinkConnected(self._member.member_id))
        tasks = [asyncio.ensure_future(each) for each in (self._listen(call), self._write(call), self._watch())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._drop_queue()
            self._deliver(LinkDisconnected(self._member.member_id))
            call.cancel()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def _take_members(self, answer: pb.RaftServiceExchangeResponse) -> None:
        with contextlib.suppress(MalformedMessage):
            # An unreadable list can be ignored, because the log contains the members anyway.
            members = tuple(decode_members(answer.members))
            if members != self._members_of_peer:
                self._members_of_peer = members
                self._deliver(MembersReported(self._member.member_id, members))

    async def _listen(self, call: Any) -> None:
        while (answer := await call.read()) is not grpc.aio.EOF:
            self._unanswered_since = None
            self._take_members(answer)
        raise LinkBroken(f"the peer ended the stream: {await call.details()}")

    async def _watch(self) -> None:
        """End the stream if the peer does not answer requests. Until it answers, the link sends empty requests.

        Without this check, a network may drop all messages for many minutes unnoticed.
        """
        limit = self._settings.timing.link_silence_seconds
        while True:
            await asyncio.sleep(limit / 4)
            since = self._unanswered_since
            if since is None:
                continue
            if asyncio.get_running_loop().time() - since > limit:
                raise LinkBroken(f"nothing was answered for {limit} s")
            self._probe_due = True
            self._work.set()

    async def _write(self, call: Any) -> None:
        while True:
            await self._work.wait()
            self._work.clear()
            while self._queue and not self._overflow:
                if self._unanswered_since is None:
                    self._unanswered_since = asyncio.get_running_loop().time()
                await call.write(self._next_request())
            if self._probe_due:
                self._probe_due = False
                await call.write(pb.RaftServiceExchangeRequest())
            if self._greet_anew:
                raise LinkBroken("this member sends a new hello, because another member refuses it")
            if self._overflow:
                raise LinkBroken("the queue is full: the peer does not keep up")

    def _next_request(self) -> pb.RaftServiceExchangeRequest:
        request, size = pb.RaftServiceExchangeRequest(), 0
        while self._queue and size < REQUEST_BYTES and len(request.messages) < REQUEST_MESSAGES_MAX:
            message, message_size = self._queue.popleft()
            request.messages.append(message)
            size += message_size
        self.queued_bytes -= size
        return request

    def _drop_queue(self) -> None:
        self._open = self._overflow = self._probe_due = self._greet_anew = False
        self._queue.clear()
        self.queued_bytes = 0
        self._unanswered_since = None


def _brief(error: BaseException) -> str:
    if isinstance(error, grpc.aio.AioRpcError):
        return f"{error.code().name}: {error.details()}"[:REASON_CHARACTERS_MAX]
    return (str(error) or type(error).__name__)[:REASON_CHARACTERS_MAX]
