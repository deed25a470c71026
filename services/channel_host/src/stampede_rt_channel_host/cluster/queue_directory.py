"""The host's calls to the directory about queues (paper, sections 3.5 and 4.3)."""

from __future__ import annotations

from stampede_rt.v1 import queue_directory_service_pb2 as pb
from stampede_rt.v1 import queue_directory_service_pb2_grpc
from stampede_rt_channel_host.cluster.records import resolved_queue
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_channel_host.core.records import ResolvedQueue

CALL_SECONDS_MAX = 4.0


class QueueDirectory:
    """Asks the directory about queues."""

    def __init__(self, supernodes: Supernodes) -> None:
        self._supernodes = supernodes

    async def resolve(self, queue_id: bytes) -> ResolvedQueue:
        """The present record of the queue (or mailbox), and its owner's address. Waits CALL_SECONDS_MAX at most.

        Raises QueueNotFound, another error of the directory, or Unavailable.
        """
        request = pb.ResolveQueueRequest(queue_id=queue_id)
        response: pb.ResolveQueueResponse = await self._supernodes.call(
            "ResolveQueue",
            request,
            CALL_SECONDS_MAX,
            service=queue_directory_service_pb2_grpc.QueueDirectoryServiceStub,
        )
        return resolved_queue(response)
