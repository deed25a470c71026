"""The host's calls to the directory about channels (paper, section 4.3)."""

from __future__ import annotations

import secrets

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.records import policy_change_message, recorded_channel
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_channel_host.core.records import PolicyChange, RecordedChannel

CALL_SECONDS_MAX = 4.0


class DirectoryQueries:
    """Asks the directory about channels, and has it change and delete them.

    Each method waits for CALL_SECONDS_MAX at most. It raises the error with which the directory answers, or
    Unavailable.
    """

    def __init__(self, supernodes: Supernodes) -> None:
        self._supernodes = supernodes

    async def resolve(self, channel_id: bytes) -> RecordedChannel:
        """The channel's present record with its owner. Raises ChannelNotFound."""
        request = pb.ResolveChannelRequest(channel_id=channel_id)
        response: pb.ResolveChannelResponse = await self._supernodes.call("ResolveChannel", request, CALL_SECONDS_MAX)
        return recorded_channel(response.channel)

    async def name_of_host(self, host_id: bytes) -> str:
        """The name of a host. Raises HostNotFound."""
        request = pb.ResolveHostRequest(host_id=host_id)
        response: pb.ResolveHostResponse = await self._supernodes.call("ResolveHost", request, CALL_SECONDS_MAX)
        return response.host.name

    async def update(
        self,
        channel_id: bytes,
        epoch: int,
        change: PolicyChange,
        *,
        request_id: bytes,
        since_s: float | None = None,
    ) -> RecordedChannel:
        """Change the policy of a channel, and return the channel's new record. Fields that `change` leaves out stay.

        `epoch` is the channel's epoch as this host knows it; the directory refuses another one. Safe to repeat with the
        same `request_id`; an empty id stands for a new random one. `since_s`: when the request was first sent, by
        `age_clock_s`; None: now.
        """
        request = pb.UpdateChannelRequest(
            request_id=request_id or secrets.token_bytes(16),
            channel_id=channel_id,
            epoch=epoch,
            spec=policy_change_message(change),
        )
        response: pb.UpdateChannelResponse = await self._supernodes.call(
            "UpdateChannel", request, CALL_SECONDS_MAX, since_s=since_s
        )
        return recorded_channel(response.channel)

    async def delete(self, channel_id: bytes, *, request_id: bytes, since_s: float | None = None) -> None:
        """Delete the channel. Safe to repeat with the same request id (see `update`). Raises ChannelNotFound."""
        request = pb.DeleteChannelRequest(request_id=request_id or secrets.token_bytes(16), channel_id=channel_id)
        await self._supernodes.call("DeleteChannel", request, CALL_SECONDS_MAX, since_s=since_s)
