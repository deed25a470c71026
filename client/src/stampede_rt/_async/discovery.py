"""Lists and watches of channels, groups, queues, peers, hosts and supernodes (paper, section 3.5)."""

from __future__ import annotations

from typing import Any

from stampede_rt._async.peer_locator import peer_not_found
from stampede_rt._async.session import CALL_TIMEOUT_S, Session
from stampede_rt._async.watch import PeerWatch, Watch
from stampede_rt.errors import DeadlineExceeded, HostNotFound, PeerNotFound, Unavailable
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.values.grouping import GroupInfo
from stampede_rt.values.model import ChannelInfo, HostInfo, SupernodeInfo
from stampede_rt.values.peering import PeerInfo
from stampede_rt.values.policy import parse_name
from stampede_rt.values.queueing import QueueInfo
from stampede_rt.values.statistics import ChannelStats
from stampede_rt.values.timeline import DurationLike
from stampede_rt.wire.groups import group_info
from stampede_rt.wire.peers import peer_info
from stampede_rt.wire.queues import queue_info
from stampede_rt.wire.records import channel_info, channel_stats, host_info, supernode_info

PAGES_MAX = 10_000  # the most pages of one list
LEADER_TIMEOUT_S = 2.5  # if the leader does not answer in this time, the client asks any supernode, without clocks


class Discovery:
    """Reads the directory. In a glob "*" matches any number of characters, "?" one.

    A long list takes several requests, one for each page. Each request blocks for at most 10 s. The methods raise
    Unavailable and InvalidArgument.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    async def channels(self, name_glob: str = "*") -> list[ChannelInfo]:
        """List the channels whose names match, sorted by name. In a glob "*" matches any characters, "?" one."""
        found: list[ChannelInfo] = []
        async for page in self._pages("ListChannels", directory_pb.ListChannelsRequest(name_glob=name_glob)):
            hosts = {host.host_id: host for host in page.hosts}
            found += [channel_info(record, hosts.get(record.host_id)) for record in page.channels]
        return found

    async def groups(self, name_glob: str = "*") -> list[GroupInfo]:
        """List the groups whose names match, sorted by name."""
        found: list[GroupInfo] = []
        async for page in self._pages("ListGroups", group_directory_pb.ListGroupsRequest(name_glob=name_glob)):
            found += [group_info(record) for record in page.groups]
        return found

    async def queues(self, name_glob: str = "*") -> list[QueueInfo]:
        """List the queues whose names match, sorted by name. Mailboxes are left out; `peers` lists their peers."""
        found: list[QueueInfo] = []
        async for page in self._pages("ListQueues", queue_directory_pb.ListQueuesRequest(name_glob=name_glob)):
            hosts = {host.host_id: host for host in page.hosts}
            found += [queue_info(record, hosts.get(record.host_id)) for record in page.queues]
        return found

    async def peers(self, name_glob: str = "*", *, include_dead: bool = False) -> list[PeerInfo]:
        """List the live peers whose names match, sorted by name, with the offsets of their clocks.

        With `include_dead` the list also has the peers whose leases have ended.
        """
        found: list[PeerInfo] = []
        request = peer_pb.ListPeersRequest(name_glob=name_glob, include_dead=include_dead, with_clocks=True)
        async for page in self._pages("ListPeers", request):
            found += [peer_info(record) for record in page.peers]
        return found

    async def peer(self, name: str) -> PeerInfo:
        """Return the live peer of that name, with the offset of its clock. Raises PeerNotFound, Unavailable."""
        request = peer_pb.ResolvePeerRequest(name=parse_name(name, "peer"), with_clocks=True)
        try:
            response = await self._ask("ResolvePeer", request)
        except PeerNotFound as error:
            raise peer_not_found(name) from error
        return peer_info(response.peer)

    async def hosts(self, *, include_dead: bool = False) -> list[HostInfo]:
        """List the live hosts, sorted by name. With `include_dead` the list also has hosts whose leases have ended."""
        found: list[HostInfo] = []
        async for page in self._pages("ListHosts", directory_pb.ListHostsRequest(include_dead=include_dead)):
            found += [host_info(record) for record in page.hosts]
        return found

    async def hosted_channels(self, host: str, name_glob: str = "*") -> dict[str, ChannelStats]:
        """Return the counters of each matching channel at the host named `host`, by the name of the channel.

        One request fetches the counters of at most 1000 channels. Raises HostNotFound if no
        live host has this name, and Unavailable if the host cannot be reached.
        """
        request = directory_pb.ResolveHostRequest(name=host)
        found = host_info((await self._session.supernodes.call("ResolveHost", request, CALL_TIMEOUT_S)).host)
        if not found.alive or not found.endpoints:
            raise HostNotFound(f"the host {host!r} is lost: its lease has ended; start it again, or name another host")
        endpoint = self._session.endpoints.to(found.endpoints[0])
        stats: dict[str, ChannelStats] = {}
        page_request = gatekeeper_pb.ListHostedChannelsRequest(name_glob=name_glob)
        for _ in range(PAGES_MAX):
            page = await endpoint.call(endpoint.gatekeeper.ListHostedChannels, page_request, CALL_TIMEOUT_S)
            stats |= {status.record.name: channel_stats(status) for status in page.channels}
            if not page.next_page_token:
                break
            page_request.page_token = page.next_page_token
        return stats

    async def _pages(self, method: str, request: Any) -> Any:
        for _ in range(PAGES_MAX):
            page = await self._ask(method, request)
            yield page
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    async def _ask(self, method: str, request: Any) -> Any:
        """Send `request` to any supernode. A request for clocks goes to the leader, because only the leader knows them.

        If the leader cannot be reached, asks any supernode for an answer without clocks.
        """
        supernodes = self._session.supernodes
        if getattr(request, "with_clocks", False):
            try:
                return await supernodes.call_leader(method, request, LEADER_TIMEOUT_S)
            except (Unavailable, DeadlineExceeded):
                request.with_clocks = False
        return await supernodes.call(method, request, CALL_TIMEOUT_S)

    async def supernodes(self) -> list[SupernodeInfo]:
        """List the supernodes, as the nearest one sees them."""
        response = await self._session.supernodes.call(
            "ListSupernodes", directory_pb.ListSupernodesRequest(), CALL_TIMEOUT_S
        )
        return [supernode_info(record) for record in response.supernodes]

    def watch(self, name_glob: str = "*", *, reconnect: DurationLike | None = None) -> Watch:
        """Watch the channels whose names match, and all hosts, from now on.

        Returns an iterator over changes that is also a context manager. After a broken connection the client tries to
        open the watch again for the duration `reconnect` (None: without a limit).
        """
        return Watch(self._session, name_glob, reconnect)

    def watch_peers(self, name_glob: str = "*", *, reconnect: DurationLike | None = None) -> PeerWatch:
        """Watch the peers whose names match, from now on. Everything else is as in `watch`."""
        return PeerWatch(self._session, name_glob, reconnect)
