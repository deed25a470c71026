"""The outgoing half of the network: one gRPC stream to every other member, in order, at most once, no retries."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import re
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import grpc
import grpc.aio

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt.v1 import raft_service_pb2_grpc
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.network.hello import OTHER_CLUSTER, UNKNOWN, other_protocol
from stampede_rt_supernode.replication.network.refusals import Grounds, Refusals, grounds_of
from stampede_rt_supernode.replication.network.reports import SparseReports
from stampede_rt_supernode.replication.raft_replica import MemberRoster
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, ReplicationSettings
from stampede_rt_supernode.replication.threads.loop_bridge import LoopBridge
from stampede_rt_supernode.replication.wire.buffered_transport import (
    Connected,
    Disconnected,
    Disputed,
    MembersTold,
    NetworkEvent,
    Outgoing,
)
from stampede_rt_supernode.replication.wire.codec import encode_message
from stampede_rt_supernode.replication.wire.records import MalformedMessage, decode_members

logger = logging.getLogger(__name__)

Dial = Callable[[str], grpc.aio.Channel]
# What to say to the member with an id.
Introduce = Callable[[str], pb.RaftHello]

REQUEST_MESSAGES_MAX = 256
REQUEST_BYTES = 1 << 20
# How often the others are asked for their word at most, so that none can keep this member's streams from standing.
ASK_OTHERS_SECONDS = 5.0
HELLO_SECONDS = 2.0
REASON_CHARACTERS_MAX = 500
# A snapshot is fed to a link only while less than this waits in it.
ROOM_BYTES = 4 << 20

# What a dialled channel needs: gRPC would otherwise wait up to two minutes before it tries a dead peer again,
# and channels with equal arguments share that wait.
CHANNEL_OPTIONS: tuple[tuple[str, int], ...] = (
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 500),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.use_local_subchannel_pool", 1),
)

# The generated class carries no types.
_stub_class: Any = raft_service_pb2_grpc.RaftServiceStub

# What gRPC puts before the words of a refusal.
_STATUS = re.compile(r"^(refused: )?(StatusCode\.)?[A-Z_]+: ")

CANCELLATIONS_MAX = 5
CANCEL_AGAIN_SECONDS = 1.0


class LinkBroken(Exception):
    """The stream ended, or was ended by us; the link starts again."""


class PeerLink:
    """The stream to one member. Everything here runs on the loop; only `queued_bytes` is read elsewhere."""

    def __init__(
        self,
        member: Member,
        settings: ReplicationSettings,
        dial: Dial,
        deliver: Callable[[NetworkEvent], None],
        on_refused: Callable[[str], None],
        introduce: Introduce,
        reports: SparseReports,
    ) -> None:
        self._reports = reports
        self.member = self._member = member
        self._on_refused = on_refused
        self._introduce = introduce
        self._settings = settings
        self._dial = dial
        self._deliver = deliver
        self._queue: deque[tuple[pb.RaftMessage, int]] = deque()
        self.queued_bytes = 0
        self._open = False
        self._overflow = False
        # Loop time of the first request that no answer has followed.
        self._unanswered_since: float | None = None
        # Whom the peer has named as members last, on this stream.
        self._told: tuple[Member, ...] = ()
        # True when an empty request shall ask for an answer.
        self._probe_due = False
        self._greet_anew = False
        self._work = asyncio.Event()

    def greet_anew(self) -> None:
        """End the stream, if there is one, so that the member says once more whether it takes this one."""
        if self._open:
            self._greet_anew = True
            self._work.set()

    def enqueue(self, message: pb.RaftMessage) -> None:
        """Queue one message; drop it when the link is down, and the whole link when its queue is full."""
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
        """Keep the stream up until cancelled."""
        pause = self._settings.timing.reconnect_seconds
        while True:
            try:
                await self._hold_stream()
            except (grpc.RpcError, LinkBroken, TimeoutError, asyncio.InvalidStateError) as error:
                self._report(_brief(error))
                self._on_refused(_brief(error))
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))

    def _report(self, reason: str) -> None:
        """Say once why there is no link, not twice a second, nor each time that somebody starts the member again."""
        # Some words tell log positions, which are others each time.
        if self._reports.is_due((self._member.member_id, grounds_of(reason) or reason), time.monotonic()):
            level = logging.INFO if UNKNOWN in reason else logging.WARNING
            logger.log(level, "no link to member %s at %s: %s", self._member.member_id, self._member.address, reason)

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
        self._told = ()
        self._take_members(answer)
        if answer.unknown_caller:
            await call.read()
            raise LinkBroken(f"refused: {await call.code()}: {await call.details()}")

    async def _pump(self, call: Any) -> None:
        self._open = True
        self._deliver(Connected(self._member.member_id))
        tasks = [asyncio.ensure_future(each) for each in (self._listen(call), self._write(call), self._watch())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._drop_queue()
            self._deliver(Disconnected(self._member.member_id))
            call.cancel()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def _take_members(self, answer: pb.RaftServiceExchangeResponse) -> None:
        with contextlib.suppress(MalformedMessage):
            # What cannot be understood is as good as not said: the log says it anyway.
            members = tuple(decode_members(answer.members))
            if members != self._told:
                self._told = members
                self._deliver(MembersTold(self._member.member_id, members))

    async def _listen(self, call: Any) -> None:
        while (answer := await call.read()) is not grpc.aio.EOF:
            self._unanswered_since = None
            self._take_members(answer)
        raise LinkBroken(f"the peer ended the stream: {await call.details()}")

    async def _watch(self) -> None:
        """End a stream on which nobody answers: the network may swallow everything for many minutes."""
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
                raise LinkBroken("it is greeted anew, since another member refuses this one")
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


class PeerLinks:
    """The links to everybody whom a replica knows: its production RaftNetwork."""

    def __init__(
        self,
        settings: ReplicationSettings,
        dial: Dial,
        bridge: LoopBridge,
        on_fatal: Callable[[BaseException], None],
    ) -> None:
        self._settings = settings
        self._dial = dial
        self._bridge = bridge
        self._on_fatal = on_fatal
        self._links: dict[str, PeerLink] = {}
        self._reports = SparseReports()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._ending: set[asyncio.Task[None]] = set()
        self._deliver: Callable[[NetworkEvent], None] | None = None
        self._introduce: Introduce | None = None
        # Who refuses this member for good.
        self.refusals = Refusals()
        # When the others were asked last whether they take this member, by the clock of durations.
        self._others_asked_at = float("-inf")
        # What a member has said that is of another cluster; empty if none has.
        self.other_cluster = ""
        # Who says that this one's release does not know the cluster's feature level.
        self.outdated = Refusals()
        # Every other member by the log, and the leader whom it follows.
        self.see: Callable[[], tuple[Collection[str], str | None]] = lambda: ((), None)
        # Told once why others refuse this member for good; blocks for one small file.
        self.on_refusal_confirmed: Callable[[str], None] = lambda why: None
        # Told of a member that breaks the rules, and how.
        self.on_fault: Callable[[str, str], None] = lambda member_id, why: None

    def start(self, deliver: Callable[[NetworkEvent], None], peers: Mapping[str, Member], introduce: Introduce) -> None:
        """Begin to connect to every peer, by what `introduce` says; on the loop."""
        self._deliver, self._introduce = deliver, introduce
        self._follow(peers)

    def follow(self, roster: MemberRoster) -> None:
        """Connect to these peers and to nobody else; from the tick thread."""
        self._bridge.post(lambda: self._follow(roster.peers))

    def _follow(self, peers: Mapping[str, Member]) -> None:
        if self._deliver is None or self._introduce is None:
            return  # not started, or closed
        for member_id, link in list(self._links.items()):
            if peers.get(member_id) != link.member:
                del self._links[member_id]
                task = self._tasks.pop(member_id)
                self._ending.add(task)
                task.add_done_callback(self._ending.discard)
                task.cancel()
        for member_id, member in peers.items():
            if member_id not in self._links:
                link = self._link(member, self._deliver, self._introduce)
                self._links[member_id] = link
                task = asyncio.get_running_loop().create_task(link.run(), name=f"raft-link-{member_id}")
                task.add_done_callback(self._on_end)
                self._tasks[member_id] = task

    def _link(self, member: Member, deliver: Callable[[NetworkEvent], None], introduce: Introduce) -> PeerLink:
        member_id = member.member_id

        def deliver_first(event: NetworkEvent) -> None:
            if isinstance(event, Connected):
                self.outdated.accepted(member_id)
                if self.refusals.accepted(member_id):
                    deliver(Disputed(member_id, ""))
            deliver(event)

        def on_refused(why: str) -> None:
            self._on_refused(member_id, why, deliver)

        return PeerLink(member, self._settings, self._dial, deliver_first, on_refused, introduce, self._reports)

    def _on_refused(self, member_id: str, why: str, deliver: Callable[[NetworkEvent], None]) -> None:
        if OTHER_CLUSTER in why:
            self.other_cluster = why
        grounds, why = grounds_of(why), _STATUS.sub("", why)
        if grounds is Grounds.TOO_OLD:
            self._count(self.outdated, member_id, why, "and ends")
        elif grounds is not None:
            self.outdated.accepted(member_id)
            if member_id not in self.refusals.by:
                deliver(Disputed(member_id, why))
            if self._count(self.refusals, member_id, why, "without a vote, and ends for good"):
                self.on_refusal_confirmed(self.refusals.why)

    def _count(self, refusals: Refusals, member_id: str, why: str, what_follows: str) -> bool:
        """Note what a member says against this one; whether that has confirmed it."""
        is_new, was_confirmed = member_id not in refusals.by, refusals.confirmed is not None
        others, leader_id = self.see()
        is_confirmed = refusals.refused(member_id, why, others=others, leader_id=leader_id)
        if is_new and not is_confirmed:
            logger.warning(
                "%s refuses this member; it goes on %s once the leader or most of the others say the same (if %s is "
                "mistaken, stop that one and start this one again): %s",
                *(member_id, what_follows, member_id, why),
            )
            self._ask_the_others(refusals)
        return is_confirmed and not was_confirmed

    def _ask_the_others(self, refusals: Refusals) -> None:
        """Have those say their word who have not refused this member: it sends them nothing by which they would."""
        now = time.monotonic()
        if now - self._others_asked_at > ASK_OTHERS_SECONDS:
            self._others_asked_at = now
            for member_id, link in self._links.items():
                if member_id not in refusals.by:
                    link.greet_anew()

    def drop(self, member_id: str, why: str) -> None:
        """Have the stream of a member ended that breaks the rules; from the tick thread."""
        self._bridge.post(lambda: self.on_fault(member_id, why))

    def release(self, messages: Sequence[Outgoing]) -> None:
        """Queue messages on their links; from the tick thread, which encodes them."""
        encoded = [(member_id, encode_message(message)) for member_id, message in messages]
        self._bridge.post(lambda: self._enqueue(encoded))

    def has_room(self, member_id: str) -> bool:
        """Whether little enough waits for this member; from the tick thread."""
        link = self._links.get(member_id)
        return link is not None and link.queued_bytes < ROOM_BYTES

    async def close(self) -> None:
        """End every stream. A cancellation that meets a call's own end can get lost in gRPC: it is said again."""
        self._deliver = None
        tasks = {*self._tasks.values(), *self._ending}
        for _ in range(CANCELLATIONS_MAX):
            for task in tasks:
                task.cancel()
            if tasks:
                _, tasks = await asyncio.wait(tasks, timeout=CANCEL_AGAIN_SECONDS)

    def _enqueue(self, messages: Sequence[tuple[str, pb.RaftMessage]]) -> None:
        for member_id, message in messages:
            link = self._links.get(member_id)
            if link is not None:  # else the member is gone, and so is its link
                link.enqueue(message)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._on_fatal(error)
