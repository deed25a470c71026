"""MigrationService on the wire: moves of channels and queues to this host, and the drain of this host."""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from functools import partial

from stampede_rt.errors import InvalidArgument, PermissionDenied, StampedeError
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import migration_service_pb2_grpc
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.cluster.records import channel_message, queue_message
from stampede_rt_channel_host.copies.moves.draining import HostDrain
from stampede_rt_channel_host.copies.moves.incoming_moves import IncomingMoves, MovedChannel
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.moves_of_drains import MovesOfDrain
from stampede_rt_channel_host.copies.queues.queue_arrivals import QueueArrivals
from stampede_rt_channel_host.copies.queues.queue_feed_servicer import QueueFeeds
from stampede_rt_channel_host.copies.queues.queue_handover import QueueHandovers
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedQueue
from stampede_rt_channel_host.queues import refusals as queue_refusals
from stampede_rt_channel_host.queues.access import check_queue_access, check_queue_known
from stampede_rt_channel_host.queues.requests import check_queue_id
from stampede_rt_runtime.access.control import check_access, check_known, current_account, current_caller
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.rpc import Context, errors_as_status

DRAIN_NANOS_MAX = 60 * 10**9
NAMES_MAX = 1000


class MigrationServicer(migration_service_pb2_grpc.MigrationServiceServicer):
    """Serves MigrationService."""

    def __init__(
        self, moves: IncomingMoves, queues: QueueArrivals, handovers: QueueHandovers, directory: MoveDirectory,
        draining: HostDrain, feeds: QueueFeeds, identity: HostIdentity, allow: Callable[[bytes, int, bytes], None],
        streams: OpenStreams,
    ) -> None:  # fmt: skip
        """`feeds`: the feeds of the replicas of queues at this host.

        `allow` notes the next owner of a channel or queue at an epoch, see `AllowedMoves.allow`. `streams` ends open
        streams when the host ends.
        """
        self._streams = streams
        self._feeds = feeds
        self._identity = identity
        self._allow = allow
        self._moves = moves
        self._queues = queues
        self._handovers = handovers
        self._directory = directory
        self._draining = draining

    @errors_as_status
    async def AllowMove(self, request: pb.AllowMoveRequest, context: Context) -> pb.AllowMoveResponse:
        """Let another host ask for a channel or queue of this host."""
        if len(request.to_host_id) != ID_BYTES:
            raise InvalidArgument(f"to_host_id has {len(request.to_host_id)} bytes; give the {ID_BYTES} of the host")
        record = await self._configurable(request.queue_id, request.channel_id)
        self._check_own(record)
        current_account().change()
        subject_id = record.channel_id if isinstance(record, RecordedChannel) else record.queue_id
        self._allow(subject_id, record.epoch, request.to_host_id)
        return pb.AllowMoveResponse()

    async def _configurable(self, queue_id: bytes, channel_id: bytes) -> RecordedChannel | RecordedQueue:
        """The record of the queue or channel. Raises PermissionDenied without the right to configure it."""
        if queue_id:
            check_queue_id(queue_id)
            queue, _ = await self._directory.queue(queue_id)
            check_queue_known(queue)
            check_queue_access(AccessVerb.CONFIGURE, queue)
            return queue
        _check_channel_id(channel_id)
        channel = await self._directory.resolve(channel_id)
        check_known(AccessKind.CHANNEL, channel.name, by_id=True)
        check_access(AccessVerb.CONFIGURE, AccessKind.CHANNEL, channel.name)
        return channel

    def _check_own(self, record: RecordedChannel | RecordedQueue) -> None:
        """Check that this host owns the thing, and that the caller is not another host.

        Rules of access do not limit hosts. So a host's certificate alone must not move things of other hosts.
        """
        if record.host_id != self._identity.host_id:
            raise _moved_error(record)
        caller = current_caller()
        if caller is not None and caller.roles == {Role.HOST} and caller.name != self._identity.name:
            raise PermissionDenied(
                f"{caller} may not move channels or queues of host {self._identity.name}; leave it to a client or an "
                "operator"
            )

    @errors_as_status
    async def MoveHere(self, request: pb.MoveHereRequest, context: Context) -> pb.MoveHereResponse:
        """Make this host the owner of a channel or queue."""
        if request.queue_id:
            return await self._move_queue_here(request.queue_id)
        hosted, blackout_nanos = await self._move_channel_here(request.channel_id)
        counters = hosted.channel.latest_counters()
        return pb.MoveHereResponse(
            channel=channel_message(hosted.record),
            held=counters.held,
            held_bytes=counters.held_bytes,
            blackout_nanos=blackout_nanos,
        )

    async def _move_channel_here(self, channel_id: bytes, *, is_of_drain: bool = False) -> MovedChannel:
        _check_channel_id(channel_id)
        record, source = await self._directory.owner_of(channel_id)
        check_known(AccessKind.CHANNEL, record.name, by_id=True)
        check_access(AccessVerb.CONFIGURE, AccessKind.CHANNEL, record.name)
        current_account().change()
        return await self._moves.move_here(record, source, is_of_drain=is_of_drain)

    @errors_as_status
    async def MoveEachHere(self, requests: AsyncIterator[pb.MoveEachHereRequest], context: Context) -> None:  # type: ignore[override]
        """Make this host the owner of the channels of another host, which drains."""
        async with self._streams.serve(context) as stream:
            await MovesOfDrain(stream, context, partial(self._move_channel_here, is_of_drain=True)).run()

    async def _move_queue_here(self, queue_id: bytes) -> pb.MoveHereResponse:
        check_queue_id(queue_id)
        record, target = await self._directory.queue(queue_id)
        check_queue_known(record)
        check_queue_access(AccessVerb.CONFIGURE, record)
        current_account().change()
        hosted, blackout_nanos = await self._queues.move_here(record, target)
        counters = hosted.queue.latest_counters()
        return pb.MoveHereResponse(
            queue=queue_message(hosted.record),
            held=counters.held,
            held_bytes=counters.held_bytes,
            blackout_nanos=blackout_nanos,
        )

    @errors_as_status
    async def HandOverQueue(self, requests: AsyncIterator[pb.HandOverQueueRequest], context: Context) -> None:  # type: ignore[override]
        """Hand a queue over to the calling host."""
        await self._handovers.serve(context)

    @errors_as_status
    async def FeedQueue(self, requests: AsyncIterator[pb.FeedQueueRequest], context: Context) -> None:  # type: ignore[override]
        """Take the feed of a replica from the owner of its queue."""
        await self._feeds.serve(context)

    @errors_as_status
    async def DrainHost(self, request: pb.DrainHostRequest, context: Context) -> pb.DrainHostResponse:
        """Move all channels and queues of this host away."""
        timeout_nanos = min(request.timeout_nanos or DRAIN_NANOS_MAX, DRAIN_NANOS_MAX)
        if timeout_nanos < 0:
            raise InvalidArgument(f"timeout_nanos is {timeout_nanos}; give more than 0, or 0 for 60 s")
        current_account().change()
        moved, unmoved = await self._draining.run(timeout_nanos / 1e9)
        named = [pb.ChannelNotMoved(name=name, reason=unmoved[name]) for name in [*unmoved][:NAMES_MAX]]
        return pb.DrainHostResponse(moved=moved, left=named, left_count=len(unmoved))


def _check_channel_id(channel_id: bytes) -> None:
    if len(channel_id) != ID_BYTES:
        raise InvalidArgument(f"channel_id has {len(channel_id)} bytes; give the {ID_BYTES} of the channel")


def _moved_error(record: RecordedChannel | RecordedQueue) -> StampedeError:
    """The error for a channel or queue of another host."""
    if isinstance(record, RecordedChannel):
        return refusals.moved(record.name, record.host_id)
    return queue_refusals.moved(record)
