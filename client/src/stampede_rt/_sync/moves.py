# Generated from ../_async by tools/generate.py; do not edit.
"""Moves channels to other hosts, while they are in use (paper, sections 4.1 and 4.2)."""

from __future__ import annotations

from stampede_rt._sync.proxies import Proxies
from stampede_rt._sync.reader import Reader
from stampede_rt.errors import HostNotFound
from stampede_rt.transports.concurrency_sync import monotonic_s
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.values.proxying import DrainInfo, MoveInfo
from stampede_rt.values.timeline import DurationLike, parse_duration

MOVE_TIMEOUT = "60s"
ANSWER_S = 5.0  # the time for the answer of a host that drains, after its timeout


class Moves(Proxies):
    """Moves of channels, by the channel's name or handle. The methods raise ChannelNotFound, Unavailable."""

    def move(self, channel: str | Reader, host: str, *, timeout: DurationLike = MOVE_TIMEOUT) -> MoveInfo:
        """Move a channel to another host, while it is in use. Its items, producers and readers go with it.

        Returns when the new host accepts puts; blocks for `timeout` at most. Puts wait for some milliseconds meanwhile,
        and blocked gets and subscriptions go on at the new host: nothing is lost, and nothing comes twice. If the
        channel is at that host already, the call returns at once. Raises HostNotFound, PermissionDenied without the
        right to configure the channel, StampedeError with reason MOVE_CONFLICT if another move of the channel is under
        way, Overloaded if 8 channels move from or to one host, or if the copy cannot catch up with the producers, and
        DeadlineExceeded (the move goes on then).
        """
        deadline_s = monotonic_s() + parse_duration(timeout, "timeout") / 1e9
        state = self._state(channel)
        hosts = {one.name: one for one in self.hosts()}
        if host not in hosts or not hosts[host].endpoints:
            raise HostNotFound(f"there is no live host {host!r}; `stampede hosts` lists them")
        endpoint = self._session.endpoints.to(hosts[host].endpoints[0])
        request = pb.MoveHereRequest(channel_id=state.info.channel_id)
        answer = endpoint.call(endpoint.moves.MoveHere, request, max(deadline_s - monotonic_s(), 0.1))
        return MoveInfo(
            channel=state.info.name,
            host=host,
            held=answer.held,
            held_bytes=answer.held_bytes,
            blackout_nanos=answer.blackout_nanos,
        )

    def drain(self, host: str, *, timeout: DurationLike = MOVE_TIMEOUT) -> DrainInfo:
        """Move all channels of a host to other hosts, while they are in use. For operators.

        Channels of one group go to the same host. Returns when all have moved, or after `timeout`, which is at most
        60 s, with the channels that have not moved and why. Queues and mailboxes stay. The host goes on to serve, and
        may get other channels. Raises HostNotFound, PermissionDenied, Unavailable.
        """
        nanos = parse_duration(timeout, "timeout")
        hosts = {one.name: one for one in self.hosts()}
        if host not in hosts or not hosts[host].endpoints:
            raise HostNotFound(f"there is no live host {host!r}; `stampede hosts` lists them")
        endpoint = self._session.endpoints.to(hosts[host].endpoints[0])
        request = pb.DrainHostRequest(timeout_nanos=nanos)
        answer = endpoint.call(endpoint.moves.DrainHost, request, nanos / 1e9 + ANSWER_S)
        left = {one.name: one.reason for one in answer.left}
        return DrainInfo(host=host, moved=answer.moved, left=left, left_count=answer.left_count)
