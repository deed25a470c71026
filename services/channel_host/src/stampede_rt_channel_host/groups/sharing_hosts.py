"""The other hosts that share groups with this one, and the links to them (paper, section 4.1).

Of each pair, the host with the lower id opens the stream. While there is no stream, the host with the higher id calls
GetCut of a shared group at the other host. The other host then learns of the group and opens the stream.
"""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Callable, Collection, Set
from typing import Any, NamedTuple

import grpc

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt.v1 import group_service_pb2_grpc
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.task_failures import first_failure
from stampede_rt_channel_host.core.group import WantedChannels
from stampede_rt_channel_host.groups.link import INTEREST_MAX, HostLink, LinkHandler
from stampede_rt_runtime.admission import caller_identity
from stampede_rt_runtime.rpc import Context

logger = logging.getLogger(__name__)

PAUSE_SECONDS_MIN, PAUSE_SECONDS_MAX = 0.05, 2.0
ASK_SECONDS_MAX = 2.0

Dial = Callable[[str], grpc.aio.Channel]


class SharingHost:
    """Another host: where it listens, the channels that this host wants from it, and the groups that both share."""

    def __init__(self, host_id: bytes) -> None:
        self.host_id = host_id
        self.target = ""
        self.wanted = WantedChannels(INTEREST_MAX)
        self.groups: set[bytes] = set()
        self.link: HostLink | None = None
        self.unlinked = asyncio.Event()  # set when the link has ended
        self.task: asyncio.Task[None] | None = None  # keeps the link; None: the hosts share no group


class ChangedMembers(NamedTuple):
    """The members of one group that one host owned until now (`former`), and the members that it owns now (`members`).

    `creator`: the caller that created the group.
    """

    creator: str
    group_id: bytes
    former: Collection[bytes]
    members: Collection[bytes]


class SharingHosts:
    """Keeps a link to each host that shares a group with this one. `lease_held` says whether this host may serve.

    The links get the facts that they send from `handler`, and pass the facts that they receive to it.
    """

    def __init__(
        self, identity: HostIdentity, handler: LinkHandler, dial: Dial, cluster_id: Callable[[], str],
        lease_held: Callable[[], bool],
    ) -> None:  # fmt: skip
        self._identity = identity
        self._handler = handler
        self._dial = dial
        self._cluster_id = cluster_id
        self._lease_held = lease_held
        self._hosts: dict[bytes, SharingHost] = {}

    def share(self, host_id: bytes, target: str | None, change: ChangedMembers) -> bool:
        """Note the members of a group that the host `host_id` owns now.

        `target`: the address of that host; None: unchanged. Drops a host that shares no group with this one any more,
        and then returns False.
        """
        other = self._hosts.get(host_id)
        if other is None:
            other = self._hosts[host_id] = SharingHost(host_id)
        changes, was_left_out = other.wanted.changes, other.wanted.left_out
        other.wanted.add(change.creator, change.members)
        other.wanted.remove(change.creator, change.former)
        if not other.wanted:
            self._drop(other)
            return False
        is_new = bool(change.members) and change.group_id not in other.groups
        (other.groups.add if change.members else other.groups.discard)(change.group_id)
        other.target = other.target if target is None else target
        if other.link is not None and other.wanted.changes != changes:
            other.link.want(other.wanted.requested)
        if other.wanted.left_out and not was_left_out:
            _warn_of_left_out(other)
        if is_new and other.link is not None:
            other.link.report_floor(change.group_id)
        if other.task is None:
            other.task = asyncio.create_task(self._keep(other), name=f"link to {host_id.hex()}")
            other.task.add_done_callback(_check)
        return True

    def is_linked(self, host_id: bytes) -> bool:
        """Whether a stream to the host is open."""
        other = self._hosts.get(host_id)
        return other is not None and other.link is not None

    def wanted_of(self, host_id: bytes) -> Set[bytes]:
        """The channels whose times this host wants from the host `host_id`, at most INTEREST_MAX."""
        other = self._hosts.get(host_id)
        return other.wanted.requested if other is not None else frozenset()

    def report_times(self, channel_id: bytes) -> None:
        """Send the times of a channel of this host to the other hosts that want them."""
        for other in self._hosts.values():
            if other.link is not None:
                other.link.report_times(channel_id)

    def report_floor(self, group_id: bytes) -> None:
        """Send this host's cut of a group to the other hosts that share the group."""
        for other in self._hosts.values():
            if other.link is not None and group_id in other.groups:
                other.link.report_floor(group_id)

    def greeted(self, link: HostLink) -> None:
        """Use a link from now on, because the other host has sent its id. The link replaces an older one to that host.

        The link first names the channels whose times this host wants. It also sends the cuts of the shared groups.
        """
        other = self._hosts.setdefault(link.host_id, SharingHost(link.host_id))
        other.link = link
        other.unlinked.clear()
        link.want(other.wanted.requested)
        for group_id in sorted(other.groups):
            link.report_floor(group_id)

    async def accept(self, context: Context) -> None:
        """Serve a stream that another host opened, until it ends."""
        self._handler.check_lease()
        caller = caller_identity(context)
        link = HostLink(
            self._identity,
            self._cluster_id(),
            self._handler,
            pb.ExchangeTimesResponse,
            context.write,
            context.read,
            certified_name=caller.name if caller is not None else "",
        )
        try:
            await _unwrapped(link.run())
        finally:
            self._unlink(link)

    async def aclose(self) -> None:
        """End the streams that this host opened, and open no more. Streams that other hosts opened stay."""
        tasks = [other.task for other in self._hosts.values() if other.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _drop(self, other: SharingHost) -> None:
        """Drop the link to a host that no longer shares a group with this one.

        If the other host opened the stream, that host decides how long the stream stays. This host remembers the link
        until the stream ends. If it forgot the link and both shared a group again, this host would wait for a new
        stream, and the other host would not open one.
        """
        other.groups = set()
        if other.link is not None:
            other.link.want(())
        if other.task is not None:
            other.task.cancel()
            other.task = None
        if other.link is None:
            del self._hosts[other.host_id]

    def _unlink(self, link: HostLink) -> None:
        other = self._hosts.get(link.host_id)
        if other is not None and other.link is link:
            other.link = None
            other.unlinked.set()
            if other.task is None:  # the two hosts share no group
                del self._hosts[link.host_id]

    async def _keep(self, other: SharingHost) -> None:
        """Keep a stream to the other host while both share a group: open the stream, or ask that host to open it."""
        pause_s = PAUSE_SECONDS_MIN
        while True:  # paced by the sleep; `_drop` cancels this task
            if other.link is None and other.target and self._lease_held():
                try:
                    opens = self._identity.host_id < other.host_id
                    await (self._open(other) if opens else self._ask_for_link(other))
                except StampedeError as error:
                    logger.debug(
                        "no link to a host",
                        extra={"event": "no_host_link", "host": other.host_id.hex(), "why": str(error)},
                    )
            if other.link is not None:  # the other host has opened the stream
                pause_s = PAUSE_SECONDS_MIN
                await other.unlinked.wait()
            await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
            pause_s = min(2 * pause_s, PAUSE_SECONDS_MAX)

    async def _open(self, other: SharingHost) -> None:
        """Open the stream and serve it until it breaks."""
        channel = self._dial(other.target)
        link: HostLink | None = None
        try:
            call = group_service_pb2_grpc.GroupServiceStub(channel).ExchangeTimes()
            link = HostLink(
                self._identity, self._cluster_id(), self._handler, pb.ExchangeTimesRequest, call.write, call.read
            )
            await _unwrapped(link.run(other.host_id))
        except grpc.RpcError as error:
            raise from_rpc_error(error, other.target) from error
        except asyncio.InvalidStateError as error:  # grpc raises this for a write after the end of the call
            raise Unavailable(f"the stream to {other.target} is broken") from error
        finally:
            if link is not None:
                self._unlink(link)
            await channel.close(None)

    async def _ask_for_link(self, other: SharingHost) -> None:
        """Call GetCut of a shared group, so that the other host learns of the group and opens the stream."""
        group_id = min(other.groups, default=None)
        if group_id is None:
            return
        channel = self._dial(other.target)
        try:
            stub = group_service_pb2_grpc.GroupServiceStub(channel)
            await stub.GetCut(pb.GetCutRequest(group_id=group_id), timeout=ASK_SECONDS_MAX)
        except grpc.RpcError as error:
            raise from_rpc_error(error, other.target) from error
        finally:
            await channel.close(None)


def _check(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (failure := task.exception()) is not None:
        logger.error(
            "a link between hosts has ended with a defect",
            exc_info=failure,
            extra={"event": "host_link_defect", "task": task.get_name()},
        )


def _warn_of_left_out(other: SharingHost) -> None:
    extra = {
        "event": "group_too_large",
        "host": other.host_id.hex(),
        "channels": len(other.wanted.requested) + other.wanted.left_out,
        "most": INTEREST_MAX,
        "created_by": other.wanted.largest_creator,
    }
    logger.warning("groups have more channels of one host than one request can name", extra=extra)


async def _unwrapped(work: Any) -> None:
    """Await `work`. If it raises an exception group, raise the first failure in the group instead."""
    try:
        await work
    except BaseExceptionGroup as group:
        raise first_failure(group) from group
