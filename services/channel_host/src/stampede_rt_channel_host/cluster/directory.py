"""What a host asks the directory about its channels (paper, section 4.3)."""

from __future__ import annotations

import secrets

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.supernodes import Supernodes

CALL_SECONDS_MAX = 4.0


class DirectoryQueries:
    """Each method blocks for CALL_SECONDS_MAX at most and raises what the directory answers, or Unavailable."""

    def __init__(self, supernodes: Supernodes) -> None:
        self._supernodes = supernodes

    async def resolve(self, channel_id: bytes) -> channel_pb2.ChannelRecord:
        """The channel as of now, its owner included. Raises ChannelNotFound."""
        request = pb.ResolveChannelRequest(channel_id=channel_id)
        response: pb.ResolveChannelResponse = await self._supernodes.call("ResolveChannel", request, CALL_SECONDS_MAX)
        return response.channel

    async def update(
        self,
        channel_id: bytes,
        epoch: int,
        spec: channel_pb2.ChannelSpec,
        *,
        request_id: bytes,
        since_s: float | None = None,
    ) -> channel_pb2.ChannelRecord:
        """The channel after the change; fields that `spec` leaves out stay. Safe to repeat with the same request id.

        `since_s`: when that was sent first, by `age_clock_s`; None: now.
        """
        request = pb.UpdateChannelRequest(
            request_id=request_id or secrets.token_bytes(16), channel_id=channel_id, epoch=epoch, spec=spec
        )
        response: pb.UpdateChannelResponse = await self._supernodes.call(
            "UpdateChannel", request, CALL_SECONDS_MAX, since_s=since_s
        )
        return response.channel

    async def delete(self, channel_id: bytes, *, request_id: bytes, since_s: float | None = None) -> None:
        """Forget the channel. Safe to repeat with the same request id, see `update`. Raises ChannelNotFound."""
        request = pb.DeleteChannelRequest(request_id=request_id or secrets.token_bytes(16), channel_id=channel_id)
        await self._supernodes.call("DeleteChannel", request, CALL_SECONDS_MAX, since_s=since_s)
