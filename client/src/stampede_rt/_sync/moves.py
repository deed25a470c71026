# Generated from ../_async by tools/generate.py; do not edit.
"""Moves channels and queues to other hosts, while they are in use (paper, sections 4.1 and 4.2)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import NamedTuple

from stampede_rt._sync.proxies import Proxies
from stampede_rt._sync.reader import Reader
from stampede_rt.errors import (
    DeadlineExceeded,
    HostNotFound,
    InvalidArgument,
    PermissionDenied,
    QueueNotFound,
    StaleBinding,
    Unavailable,
)
from stampede_rt.transports.concurrency_sync import monotonic_s, sleep
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.values.balancing import PlannedMove, plan_moves
from stampede_rt.values.proxying import DrainInfo, MoveInfo
from stampede_rt.values.statistics import ChannelStats
from stampede_rt.values.timeline import DurationLike, parse_duration

MOVE_TIMEOUT = "60s"
DRAIN_NANOS_MAX = 60 * 10**9
OVER_NANOS_MAX = 3600 * 10**9
ITEM_WORK_BYTES = 4096  # an item costs a host about as much work as this number of bytes
RETRY_S = 0.05
ANSWER_S = 5.0  # the time for the answer of a host that drains, after its timeout


class _MovableSubject(NamedTuple):
    """The owner of a channel or queue, and the request that has another host take over this channel or queue."""

    owner: str
    request: pb.MoveHereRequest


class Moves(Proxies):
    """Moves of channels, by the channel's name or handle, and of queues. All raise ChannelNotFound, Unavailable."""

    def move(self, channel: str | Reader, host: str, *, timeout: DurationLike = MOVE_TIMEOUT) -> MoveInfo:
        """Move a channel to another host, while it is in use. Its items, producers and readers go with it.

        Returns when the new host accepts puts; blocks for `timeout` at most. Puts wait for some milliseconds meanwhile,
        and blocked gets and subscriptions continue at the new host: nothing is lost, and nothing comes twice. If the
        channel is at that host already, the call returns immediately. Raises HostNotFound, PermissionDenied without the
        right to configure the channel, MoveConflict if another move of the channel is under way, Unavailable if too few
        of its replicas are in sync, Overloaded if 128 channels move from or to one host, or if the copy cannot catch up
        with the producers, and DeadlineExceeded (the move then continues).
        """
        deadline_s = monotonic_s() + parse_duration(timeout, "timeout") / 1e9
        name = channel.name if isinstance(channel, Reader) else channel

        def find() -> _MovableSubject:
            info = (self._state(channel)).info
            return _MovableSubject(info.host, pb.MoveHereRequest(channel_id=info.channel_id))

        return _info(name, host, self._move_here(find, host, deadline_s))

    def move_queue(self, queue: str, host: str, *, timeout: DurationLike = MOVE_TIMEOUT) -> MoveInfo:
        """Move the queue of that name to another host, while it is in use. Its messages, leases and retries go with it.

        Returns when the new host serves the queue; blocks for `timeout` at most. Calls and streams of the queue wait
        meanwhile, because the whole queue moves in one step. Takers keep their leases, and settle at the new host. If
        the queue is at that host already, the call returns immediately. Raises QueueNotFound, HostNotFound,
        PermissionDenied without the right to configure the queue, Overloaded if 8 queues move from or to one host,
        Unavailable if its copy takes longer than 60 s, and DeadlineExceeded (the move then continues).
        """
        deadline_s = monotonic_s() + parse_duration(timeout, "timeout") / 1e9

        def find() -> _MovableSubject:
            found = next((one for one in self.queues(queue) if one.name == queue), None)
            if found is None:
                raise QueueNotFound(f"there is no queue {queue!r}; `stampede queue ls` lists the queues")
            return _MovableSubject(found.host, pb.MoveHereRequest(queue_id=found.queue_id))

        return _info(queue, host, self._move_here(find, host, deadline_s))

    def _move_here(self, find: Callable[[], _MovableSubject], host: str, deadline_s: float) -> pb.MoveHereResponse:
        """Let the owner permit the move to `host`, and then have `host` take over the channel or queue."""
        hosts = {one.name: one for one in self.hosts() if one.endpoints}
        if host not in hosts:
            raise HostNotFound(f"there is no live host {host!r}; `stampede hosts` lists the hosts")
        while True:  # tries again, until the deadline, if another move of the channel or queue has just ended
            found = find()
            try:
                if found.owner != host and found.owner in hosts:
                    self._allow(found.request, hosts[found.owner].endpoints[0], hosts[host].host_id, deadline_s)
                endpoint = self._session.endpoints.to(hosts[host].endpoints[0])
                left_s = max(deadline_s - monotonic_s(), 0.1)
                answer: pb.MoveHereResponse = endpoint.call(endpoint.moves.MoveHere, found.request, left_s)
                return answer
            except (StaleBinding, PermissionDenied) as error:
                # A PermissionDenied with a host_id is about `_allow`: the owner or the epoch has changed since then.
                is_denied = isinstance(error, PermissionDenied) and "host_id" not in error.metadata
                if is_denied or monotonic_s() >= deadline_s:
                    raise
            sleep(RETRY_S)

    def _allow(self, request: pb.MoveHereRequest, owner: str, host_id: bytes, deadline_s: float) -> None:
        """Permit one host to take over the channel or queue. Raises StaleBinding if `owner` no longer owns it."""
        allow = pb.AllowMoveRequest(channel_id=request.channel_id, queue_id=request.queue_id, to_host_id=host_id)
        endpoint = self._session.endpoints.to(owner)
        endpoint.call(endpoint.moves.AllowMove, allow, max(deadline_s - monotonic_s(), 0.1))

    def rebalance(self, *, apply: bool = False, over: DurationLike = "2s") -> list[PlannedMove]:
        """Plan moves that even out the loads of the hosts. With `apply` also perform them, one after the other.

        The plan uses the loads that the hosts last reported to the directory, and the work of each channel, measured
        for `over`. Channels of one group at one host stay together. Without `apply` the call only returns the plan.
        Hosts whose loads differ by less than a tenth of a core stay as they are, and so do channels with an archive.
        Hosts that leave meanwhile, or do not answer, take no part. `over` is more than 0 and at most an hour. Raises
        InvalidArgument, and the errors of `move`.
        """
        over_nanos = parse_duration(over, "over")
        if not 0 < over_nanos <= OVER_NANOS_MAX:
            raise InvalidArgument(f"over is {over}; measure for more than 0 s and at most 1 h")
        loads = {one.name: one.load for one in self.hosts() if one.load is not None}
        hosts = {name: load.busy_permille for name, load in loads.items() if not load.private}
        rates = self._rates(hosts, over_nanos / 1e9)
        hosts = {name: busy for name, busy in hosts.items() if name in rates}
        channels = self.channels()
        names = {one.channel_id: one.name for one in channels}
        staying = {one.name for one in channels if one.policy.is_recorded}
        groups = [[names[one] for one in group.channel_ids if one in names] for group in self.groups()]
        planned = plan_moves(hosts, rates, groups, staying)
        for step in planned if apply else ():
            self.move(step.channel, step.host)
        return planned

    def _rates(self, hosts: Collection[str], over_s: float) -> dict[str, dict[str, float]]:
        """Measure the work of each channel for `over_s` seconds. Returns the work by host and channel name.

        Leaves out hosts that leave meanwhile, or do not answer.
        """
        before = self._counters(hosts)
        sleep(over_s)
        after = self._counters(before)
        owners = {one.name: one.host for one in self.channels()}  # a host also lists its copies of other channels
        return {
            host: {
                name: _work_since(before[host], name, new) for name, new in counters.items() if owners.get(name) == host
            }
            for host, counters in after.items()
        }

    def _counters(self, hosts: Collection[str]) -> dict[str, dict[str, ChannelStats]]:
        """Return the counters of the channels at each host that answers."""
        found: dict[str, dict[str, ChannelStats]] = {}
        for host in hosts:
            with suppress(HostNotFound, Unavailable, DeadlineExceeded):
                found[host] = self.hosted_channels(host)
        return found

    def drain(self, host: str, *, timeout: DurationLike = MOVE_TIMEOUT) -> DrainInfo:
        """Move all channels, queues and mailboxes of a host to other hosts, while they are in use. For operators.

        Channels of one group go to the same host. Returns when all have moved, or after `timeout`, which is at most 60
        s. The answer names the channels that have not moved, and why. The host continues to serve, and may get other
        channels. Raises InvalidArgument, HostNotFound, PermissionDenied, Unavailable.
        """
        nanos = _drain_nanos(timeout)
        hosts = {one.name: one for one in self.hosts()}
        if host not in hosts or not hosts[host].endpoints:
            raise HostNotFound(f"there is no live host {host!r}; `stampede hosts` lists the hosts")
        endpoint = self._session.endpoints.to(hosts[host].endpoints[0])
        request = pb.DrainHostRequest(timeout_nanos=nanos)
        answer = endpoint.call(endpoint.moves.DrainHost, request, nanos / 1e9 + ANSWER_S)
        left = {one.name: one.reason for one in answer.left}
        return DrainInfo(host=host, moved=answer.moved, left=left, left_count=answer.left_count)


def _drain_nanos(timeout: DurationLike) -> int:
    """Return the time of a drain. Raises InvalidArgument, also for 0, which has another meaning in the contract."""
    nanos = parse_duration(timeout, "timeout")
    if not 0 < nanos <= DRAIN_NANOS_MAX:
        raise InvalidArgument(f"timeout is {timeout}; a drain takes more than 0 s and at most 60 s")
    return nanos


def _info(name: str, host: str, answer: pb.MoveHereResponse) -> MoveInfo:
    return MoveInfo(
        channel=name,
        host=host,
        held=answer.held,
        held_bytes=answer.held_bytes,
        blackout_nanos=answer.blackout_nanos,
    )


def _work(stats: ChannelStats) -> float:
    """The work of a host for a channel, in bytes: the bytes in and out, and ITEM_WORK_BYTES for each item."""
    return stats.accepted_bytes + stats.delivered_bytes + ITEM_WORK_BYTES * stats.accepted


def _work_since(before: Mapping[str, ChannelStats], name: str, now: ChannelStats) -> float:
    """The work for a channel since `before`, and a little more."""
    return _work(now) - _work(before.get(name, now)) + 1.0
