"""The incoming half of the network: the RaftService of one member.

It serves only members. A caller states its member id in the hello. If the cluster has certificates, the caller's
certificate must contain that id. The server's interceptors have checked the cluster's secret and the certificate's role
before.
"""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any

import grpc
import grpc.aio

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt.v1 import raft_service_pb2_grpc
from stampede_rt_runtime.admission import caller_identity
from stampede_rt_runtime.rpc import Context
from stampede_rt_supernode.replication.arrivals import InboxFull
from stampede_rt_supernode.replication.network.hello import (
    ANOTHER_STORE,
    OLDER_STORE,
    OTHER_CLUSTER,
    HelloRefusal,
    introduced_member,
    refusal_of,
)
from stampede_rt_supernode.replication.network.peer_link import REQUEST_MESSAGES_MAX
from stampede_rt_supernode.replication.network.refusals import grounds_of
from stampede_rt_supernode.replication.network.reports import ReportLimiter
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, ReplicationSettings
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.wire.buffered_transport import (
    MessageReceived,
    NodeIntroduced,
    StreamEnded,
    StreamOpened,
)
from stampede_rt_supernode.replication.wire.codec import decode_message
from stampede_rt_supernode.replication.wire.records import MalformedMessage, encode_members

# How long a caller may take to send its hello.
HELLO_SECONDS = 5.0
# How long this member refuses a member that breaks the protocol.
EXPELLED_SECONDS = 5.0
# The shortest time between two answers to a sender. An answer shows the sender that its messages arrive.
ANSWER_SECONDS = 0.5

logger = logging.getLogger(__name__)

# The generated function has no types.
_register: Any = raft_service_pb2_grpc.add_RaftServiceServicer_to_server


class RaftServicer:
    """Accepts the streams of the other members. Runs on the loop."""

    def __init__(self, settings: ReplicationSettings, replica: RaftReplica, stores: KnownStores) -> None:
        self._settings = settings
        self._stores = stores
        self._replica = replica
        # Id of another member -> why this member refused the other's store at the latest hello.
        self._refused: dict[str, str] = {}
        # Member id -> until when it is refused, on the monotonic clock, and why.
        self._expelled: dict[str, tuple[float, str]] = {}
        # Member id -> the task that reads the member's present stream. A member has at most one stream.
        self._readers: dict[str, asyncio.Task[None]] = {}
        self._reports = ReportLimiter()
        self._closed = False

    def add_to_server(self, server: grpc.aio.Server) -> None:
        """Register with a server that is not started yet."""
        _register(self, server)

    async def Exchange(self, request_iterator: Any, context: Context) -> None:  # noqa: N802
        """Serve one member's stream until it ends, a newer one replaces it, or this member closes."""
        hello = await self._welcome(context)
        member_id = hello.member_id
        replaced = self._readers.pop(member_id, None)
        if replaced is not None:
            replaced.cancel()
        self._replica.deliver(StreamOpened(member_id, hello.highest_feature_level))
        reader = asyncio.get_running_loop().create_task(self._receive(member_id, context))
        self._readers[member_id] = reader
        try:
            await asyncio.wait((reader,))
        finally:
            reader.cancel()
            if self._readers.get(member_id) is reader:
                del self._readers[member_id]
                self._replica.deliver(StreamEnded(member_id))
        await self._explain(reader, context)

    def refused(self) -> dict[str, str]:
        """By id: the members whose stores this member refused at their latest hello, and why.

        Leaves out a member that has a stream. Then the refused caller was another process, with a copy of its folder.
        """
        members = {member.member_id for member in self._replica.roster.members} - self._readers.keys()
        return {member_id: why for member_id, why in self._refused.items() if member_id in members}

    def expel(self, member_id: str, why: str) -> None:
        """End the stream of a member that breaks the protocol, and refuse it for a while."""
        self._expelled = {one: refusal for one, refusal in self._expelled.items() if refusal[0] > time.monotonic()}
        self._expelled[member_id] = time.monotonic() + EXPELLED_SECONDS, why
        if self._reports.is_due((member_id, "expelled"), time.monotonic()):
            logger.error(
                "%s: this breaks the protocol, and this supernode refuses the member for %.0f s; if it happens again, "
                "stop the member, remove it (stampede supernode remove %s), and find out which program runs there",
                *(why, EXPELLED_SECONDS, member_id),
                extra={"event": "member_expelled"},
            )
        if (reader := self._readers.get(member_id)) is not None:
            reader.cancel()

    def close(self) -> None:
        """End every stream, and refuse new ones."""
        self._closed = True
        for reader in self._readers.values():
            reader.cancel()

    async def _welcome(self, context: Context) -> pb.RaftHello:
        try:
            async with asyncio.timeout(HELLO_SECONDS):
                request = await context.read()
        except TimeoutError:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "no hello came in time")
        if request is grpc.aio.EOF or not request.HasField("hello") or request.messages:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "a stream begins with a hello and nothing else")
        await self._check(request.hello, context)
        # The store is noted before this member processes any message of the caller.
        members = {member.member_id for member in self._replica.roster.members}
        await asyncio.to_thread(self._stores.note, request.hello.member_id, request.hello.store_id, members)
        await context.write(self._greeting(knows_caller=True))
        hello: pb.RaftHello = request.hello
        return hello

    def _greeting(self, *, knows_caller: bool) -> pb.RaftServiceExchangeResponse:
        return pb.RaftServiceExchangeResponse(
            protocol_version=PROTOCOL_VERSION,
            members=encode_members(self._replica.roster.members),
            unknown_caller=not knows_caller,
        )

    async def _check(self, hello: pb.RaftHello, context: Context) -> None:
        if self._closed:
            await context.abort(grpc.StatusCode.UNAVAILABLE, "this member is closing")
        caller = caller_identity(context)
        if caller is not None and caller.name != hello.member_id:
            await context.abort(
                grpc.StatusCode.PERMISSION_DENIED, f"{hello.member_id!r} uses the certificate of {caller}"
            )
        refused_until_s, why = self._expelled.get(hello.member_id, (0.0, ""))
        if refused_until_s > time.monotonic():
            await context.abort(grpc.StatusCode.UNAVAILABLE, f"refused for {EXPELLED_SECONDS:.0f} s: {why}")
        roster, promise = self._replica.roster, self._replica.promise_of(hello.member_id)
        refusal = refusal_of(
            hello,
            self._settings,
            roster=roster,
            stores=self._stores,
            promise=promise,
            feature_level=self._replica.feature_level,
        )
        self._note_outcome(hello, refusal, context.peer())
        if refusal is None:
            return
        if refusal.sends_members:
            if (member := introduced_member(hello, self._settings)) is not None:
                self._replica.deliver(NodeIntroduced(member.member_id, member))
            # The caller may not know the members that already know the caller.
            await context.write(self._greeting(knows_caller=False))
        await context.abort(refusal.code, refusal.why)

    def _note_outcome(self, hello: pb.RaftHello, refusal: HelloRefusal | None, peer: str) -> None:
        """If this member has refused the caller's store, remember and log that. If not, forget an earlier refusal.

        `peer`: the caller's address.
        """
        if refusal is not None and OTHER_CLUSTER in refusal.why:
            self._log_other_cluster(hello)
        if refusal is None or not (ANOTHER_STORE in refusal.why or OLDER_STORE in refusal.why):
            self._refused.pop(hello.member_id, None)
            return
        self._refused[hello.member_id] = refusal.why
        has_stream = hello.member_id in self._readers
        # Compares the grounds, because the words contain log positions, which differ at each attempt.
        if not self._reports.is_due((hello.member_id, grounds_of(refusal.why), has_stream), time.monotonic()):
            return
        if has_stream:
            advice = f"the real {hello.member_id} is connected, so the caller has a copy of its folder: stop the copy"
        else:
            advice = "remove it (stampede supernode remove), and join under a new id"
        logger.warning("refused a caller at %s: %s; %s", peer, refusal.why, advice, extra={"event": "member_refused"})

    def _log_other_cluster(self, hello: pb.RaftHello) -> None:
        """Log that a member of another cluster calls. For example, this member was started without its folder."""
        own = self._settings.self_member.member_id
        if self._reports.is_due((hello.member_id, hello.cluster_id), time.monotonic()):
            logger.warning(
                "member %s of another cluster (%s) calls this address, and expects its member %s here. This is %s of "
                "cluster %s: if this supernode should be that member, stop this one, and start it with the --data-dir "
                "of that member",
                *(hello.member_id, hello.cluster_id, hello.peer_member_id, own, self._settings.cluster_id),
                extra={"event": "other_cluster_member"},
            )

    async def _receive(self, member_id: str, context: Context) -> None:
        loop = asyncio.get_running_loop()
        answered_at = loop.time()
        while (request := await context.read()) is not grpc.aio.EOF:
            # This stream belongs to the member itself. So the caller that was refused under this id had a copy of its
            # folder.
            self._refused.pop(member_id, None)
            if member_id not in self._replica.roster.peers:
                raise MalformedMessage(f"{member_id!r} is no longer a member")
            if request.HasField("hello") or len(request.messages) > REQUEST_MESSAGES_MAX:
                raise MalformedMessage("a second hello, or too many messages in one request")
            for message in request.messages:
                self._replica.deliver(MessageReceived(member_id, decode_message(message), message.ByteSize()))
            if loop.time() - answered_at >= ANSWER_SECONDS:
                answered_at = loop.time()
                await context.write(self._greeting(knows_caller=True))

    async def _explain(self, reader: asyncio.Task[None], context: Context) -> None:
        if reader.cancelled():
            await context.abort(
                grpc.StatusCode.UNAVAILABLE,
                "this member closes, has a newer stream of the caller, or refuses the caller for a while",
            )
        error = reader.exception()
        if isinstance(error, MalformedMessage):
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))
        if isinstance(error, InboxFull):
            await context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, str(error))
        if error is not None:
            raise error
