# Generated from ../_async by tools/generate.py; do not edit.
"""A participant's connection to the cluster: channels by name, and discovery."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Any

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.cross_section import cross_section
from stampede_rt._sync.group import Group, GroupChannel, member_handles
from stampede_rt._sync.session import CALL_TIMEOUT_S, ChannelState, Session, request_id
from stampede_rt._sync.watch import Watch
from stampede_rt.codecs import Codec, Coding
from stampede_rt.errors import HostNotFound
from stampede_rt.grouping import (
    MAX_LEAD_DEFAULT,
    OLDEST_REFERENCE,
    CrossSection,
    GroupInfo,
    parse_group_bound,
    parse_members,
    parse_reference,
)
from stampede_rt.model import ChannelInfo, ChannelStats, HostInfo, SupernodeInfo
from stampede_rt.policy import parse_name, parse_policy
from stampede_rt.timeline import NOW, BoundLike, DurationLike, parse_duration
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.wire.groups import group_info, group_spec
from stampede_rt.wire.records import channel_info, channel_stats, host_info, supernode_info

PAGES_MAX = 10_000


class Connection:
    """What `connect` gives: the way to channels and to the directory. A context manager; close it or leave it."""

    def __init__(self, session: Session, name: str) -> None:
        self._session = session
        self.name = name

    def open(self) -> Connection:
        """Find the cluster, within 5 s. Raises Unavailable, PermissionDenied, VersionMismatch."""
        self._session.open()
        return self

    def __enter__(self) -> Connection:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End everything that is under way; handles of this connection do not work any more."""
        self._session.close()

    @property
    def cluster_id(self) -> str:
        """Which cluster this is."""
        return self._session.supernodes.cluster_id

    def channel(
        self,
        name: str,
        *,
        max_age: DurationLike | None = None,
        max_items: int | None = None,
        max_bytes: int | None = None,
        consumers: int | None = None,
        on_full: str | None = None,
        max_future: DurationLike | None = None,
        content_type: str | None = None,
        codec: str | Codec | None = None,
        host: str | None = None,
        create: bool = True,
    ) -> Channel:
        """Get or create a channel (paper, section 3.4 for the policies).

        Arguments left out are never compared; a stated one that contradicts what was stated before raises
        ChannelExists. Unstated: max_age "10s" if no limit at all is stated, max_bytes 256 MiB, on_full "drop_oldest",
        max_future "1s". `host` names the host to create it at. `create=False` raises ChannelNotFound if it is absent.

        `codec` belongs to the handle, not to the channel: what `put` takes and `item.value` gives. "bytes" (default),
        "json", "numpy" (shape and dtype kept), or an object with `content_type`, `encode` and `decode`.
        """
        stated = parse_policy(
            max_age=max_age,
            max_items=max_items,
            max_bytes=max_bytes,
            consumers=consumers,
            on_full=on_full,
            max_future=max_future,
            content_type=content_type,
        )
        coding = Coding.parse(codec, f"channel {parse_name(name)!r}", content_type)
        info = self._session.open_channel(name, stated, host, create)
        return Channel(self._session, ChannelState(info, stated, create, coding))

    def group(
        self,
        name: str,
        channels: Sequence[Channel] | None = None,
        *,
        reference: Channel | str = OLDEST_REFERENCE,
        bound: str = "start",
        idle_after: DurationLike | None = None,
        max_lead: DurationLike = MAX_LEAD_DEFAULT,
    ) -> Group:
        """Get or create a group of channels that are read in step (paper, section 3.3); by name alone: get it.

        Through the group only items before its cut are visible. `reference` "oldest": the cut is the smallest of all
        members'; a channel: that one's. `bound` "start": a channel's cut is its newest item's time; "end": where that
        item's duration ends, at most `max_lead` later. `idle_after`: how long a member may be silent before it is left
        out of "oldest"; None: never. Raises GroupExists if a group of the name is set up otherwise, GroupNotFound.
        """
        if channels is None:
            request = group_directory_pb.OpenGroupRequest(request_id=request_id(), name=parse_name(name, "group"))
        else:
            members = parse_members(channels)
            spec = group_spec(
                [member.info.channel_id for member in members],
                parse_reference(reference, members),
                parse_group_bound(bound),
                None if idle_after is None else parse_duration(idle_after, "idle_after"),
                parse_duration(max_lead, "max_lead"),
            )
            request = group_directory_pb.OpenGroupRequest(
                request_id=request_id(), name=parse_name(name, "group"), spec=spec, create=True
            )
        response = self._session.supernodes.call("OpenGroup", request, CALL_TIMEOUT_S)
        return Group(self._session, group_info(response.group), member_handles(self._session, response, channels or ()))

    def groups(self, name_glob: str = "*") -> list[GroupInfo]:
        """The groups whose names match, see `channels`; in the order of names."""
        found: list[GroupInfo] = []
        for page in self._pages("ListGroups", group_directory_pb.ListGroupsRequest(name_glob=name_glob)):
            found += [group_info(record) for record in page.groups]
        return found

    def cross_section(
        self,
        reference: Channel | GroupChannel,
        others: Sequence[Channel | GroupChannel],
        at: BoundLike = NOW,
        *,
        over: str = "start",
        complete: bool = False,
        payloads: bool = True,
        timeout: float | None = 0,
    ) -> CrossSection[Channel | GroupChannel]:
        """What every channel holds at one item of `reference`: the last one whose span holds `at`.

        `over` "start": the items of `others` whose span holds that item's time; "span": all that share an instant with
        its span. With `complete` each channel is waited for until it has passed that, `timeout` seconds in all at the
        most, None: for ever. `section.time` is None, and every channel but the reference left out, if it holds nothing.
        """
        return cross_section(reference, others, at, over=over, complete=complete, payloads=payloads, timeout=timeout)

    def channels(self, name_glob: str = "*") -> list[ChannelInfo]:
        """The channels whose names match; "*" stands for any run of characters, "?" for one. In the order of names."""
        found: list[ChannelInfo] = []
        for page in self._pages("ListChannels", directory_pb.ListChannelsRequest(name_glob=name_glob)):
            hosts = {host.host_id: host for host in page.hosts}
            found += [channel_info(record, hosts.get(record.host_id)) for record in page.channels]
        return found

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
        port = self._session.ports.to(found.endpoints[0])
        stats: dict[str, ChannelStats] = {}
        page_request = gatekeeper_pb.ListHostedChannelsRequest(name_glob=name_glob)
        for _ in range(PAGES_MAX):
            page = port.call(port.gatekeeper.ListHostedChannels, page_request, CALL_TIMEOUT_S)
            stats |= {status.record.name: channel_stats(status) for status in page.channels}
            if not page.next_page_token:
                break
            page_request.page_token = page.next_page_token
        return stats

    def _pages(self, method: str, request: Any) -> Any:
        for _ in range(PAGES_MAX):
            page = self._session.supernodes.call(method, request, CALL_TIMEOUT_S)
            yield page
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def supernodes(self) -> list[SupernodeInfo]:
        """The supernodes, as the nearest one sees them."""
        response = self._session.supernodes.call("ListSupernodes", directory_pb.ListSupernodesRequest(), CALL_TIMEOUT_S)
        return [supernode_info(record) for record in response.supernodes]

    def watch(self, name_glob: str = "*") -> Watch:
        """Changes of channels whose names match, and of hosts, from now on: an iterator and context manager."""
        return Watch(self._session, name_glob)
