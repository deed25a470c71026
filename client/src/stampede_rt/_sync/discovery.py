# Generated from ../_async by tools/generate.py; do not edit.
"""What is there: channels, groups, queues, participants, hosts and supernodes (paper, section 3.5)."""

from __future__ import annotations

from typing import Any

from stampede_rt._sync.peer_locator import peer_not_found
from stampede_rt._sync.session import CALL_TIMEOUT_S, Session
from stampede_rt._sync.watch import PeerWatch, Watch
from stampede_rt.errors import DeadlineExceeded, HostNotFound, PeerNotFound, Unavailable
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.values.grouping import GroupInfo
from stampede_rt.values.model import ChannelInfo, ChannelStats, HostInfo, SupernodeInfo
from stampede_rt.values.peering import PeerInfo
from stampede_rt.values.policy import parse_name
from stampede_rt.values.queueing import QueueInfo
from stampede_rt.values.timeline import DurationLike
from stampede_rt.wire.groups import group_info
from stampede_rt.wire.peers import peer_info
from stampede_rt.wire.queues import queue_info
from stampede_rt.wire.records import channel_info, channel_stats, host_info, supernode_info

PAGES_MAX = 10_000
LEADER_TIMEOUT_S = 2.5  # then what the leader alone knows is left out


class Discovery:
    """Asks the directory. In a glob "*" stands for any run of characters, "?" for one."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def channels(self, name_glob: str = "*") -> list[ChannelInfo]:
        """The channels whose names match; "*" stands for any run of characters, "?" for one. In the order of names."""
        found: list[ChannelInfo] = []
        for page in self._pages("ListChannels", directory_pb.ListChannelsRequest(name_glob=name_glob)):
            hosts = {host.host_id: host for host in page.hosts}
            found += [channel_info(record, hosts.get(record.host_id)) for record in page.channels]
        return found

    def groups(self, name_glob: str = "*") -> list[GroupInfo]:
        """The groups whose names match, see `channels`; in the order of names."""
        found: list[GroupInfo] = []
        for page in self._pages("ListGroups", group_directory_pb.ListGroupsRequest(name_glob=name_glob)):
            found += [group_info(record) for record in page.groups]
        return found

    def queues(self, name_glob: str = "*") -> list[QueueInfo]:
        """The queues whose names match, see `channels`; in the order of names. Mailboxes are found by `peers`."""
        found: list[QueueInfo] = []
        for page in self._pages("ListQueues", queue_directory_pb.ListQueuesRequest(name_glob=name_glob)):
            hosts = {host.host_id: host for host in page.hosts}
            found += [queue_info(record, hosts.get(record.host_id)) for record in page.queues]
        return found

    def peers(self, name_glob: str = "*", *, include_dead: bool = False) -> list[PeerInfo]:
        """The participants whose names match, see `channels`; in the order of names. Live ones with their clocks."""
        found: list[PeerInfo] = []
        request = peer_pb.ListPeersRequest(name_glob=name_glob, include_dead=include_dead, with_clocks=True)
        for page in self._pages("ListPeers", request):
            found += [peer_info(record) for record in page.peers]
        return found

    def peer(self, name: str) -> PeerInfo:
        """The live participant with that name, and its clock. Raises PeerNotFound."""
        request = peer_pb.ResolvePeerRequest(name=parse_name(name, "peer"), with_clocks=True)
        try:
            response = self._ask("ResolvePeer", request)
        except PeerNotFound as error:
            raise peer_not_found(name) from error
        return peer_info(response.peer)

    def hosts(self, *, include_dead: bool = False) -> list[HostInfo]:
        """The channel hosts, in the order of names."""
        found: list[HostInfo] = []
        for page in self._pages("ListHosts", directory_pb.ListHostsRequest(include_dead=include_dead)):
            found += [host_info(record) for record in page.hosts]
        return found

    def hosted_channels(self, host: str, name_glob: str = "*") -> dict[str, ChannelStats]:
        """The channels at one host by name, with their counters: one request for each 1000, and no payload.

        Raises HostNotFound; Unavailable if the host cannot be reached.
        """
        request = directory_pb.ResolveHostRequest(name=host)
        found = host_info((self._session.supernodes.call("ResolveHost", request, CALL_TIMEOUT_S)).host)
        if not found.alive or not found.endpoints:
            raise HostNotFound(f"the host {host!r} is lost: its lease has ended; start it again, or name another")
        endpoint = self._session.endpoints.to(found.endpoints[0])
        stats: dict[str, ChannelStats] = {}
        page_request = gatekeeper_pb.ListHostedChannelsRequest(name_glob=name_glob)
        for _ in range(PAGES_MAX):
            page = endpoint.call(endpoint.gatekeeper.ListHostedChannels, page_request, CALL_TIMEOUT_S)
            stats |= {status.record.name: channel_stats(status) for status in page.channels}
            if not page.next_page_token:
                break
            page_request.page_token = page.next_page_token
        return stats

    def _pages(self, method: str, request: Any) -> Any:
        for _ in range(PAGES_MAX):
            page = self._ask(method, request)
            yield page
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def _ask(self, method: str, request: Any) -> Any:
        """Ask whoever answers; for clocks the leader, who alone knows them. If it does not answer, there are none."""
        supernodes = self._session.supernodes
        if getattr(request, "with_clocks", False):
            try:
                return supernodes.call_leader(method, request, LEADER_TIMEOUT_S)
            except (Unavailable, DeadlineExceeded):
                request.with_clocks = False
        return supernodes.call(method, request, CALL_TIMEOUT_S)

    def supernodes(self) -> list[SupernodeInfo]:
        """The supernodes, as the nearest one sees them."""
        response = self._session.supernodes.call("ListSupernodes", directory_pb.ListSupernodesRequest(), CALL_TIMEOUT_S)
        return [supernode_info(record) for record in response.supernodes]

    def watch(self, name_glob: str = "*", *, reconnect: DurationLike | None = None) -> Watch:
        """Changes of channels whose names match, and of hosts, from now on: an iterator and context manager.

        `reconnect`: for how long it tries to come back after its connection broke, None: for ever.
        """
        return Watch(self._session, name_glob, reconnect)

    def watch_peers(self, name_glob: str = "*", *, reconnect: DurationLike | None = None) -> PeerWatch:
        """Changes of participants whose names match, from now on; else as `watch`."""
        return PeerWatch(self._session, name_glob, reconnect)
