"""The requests of a host to the directory about moves."""

from __future__ import annotations

from typing import Any

import grpc
import pytest
from grpc.aio import Metadata

from stampede_rt.errors import ChannelNotFound, StampedeError
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import migration_directory_service_pb2 as moves_pb
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.replica_directory import FeedSource

OWN = b"h" * 16


class Pages:
    """A directory that answers with one host on each page."""

    def __init__(self, *hosts: pb.HostRecord) -> None:
        self.hosts = hosts

    async def call(self, method: str, request: pb.ListHostsRequest, timeout_s: float) -> pb.ListHostsResponse:
        assert method == "ListHosts"
        at = int(request.page_token or "0")
        following = str(at + 1) if at + 1 < len(self.hosts) else ""
        return pb.ListHostsResponse(hosts=[self.hosts[at]], next_page_token=following)


def record(name: str, host_id: bytes, *, alive: bool = True) -> Any:
    made = pb.ListHostsResponse().hosts.add(host_id=host_id, name=name, alive=alive)
    made.gatekeepers.add(target=f"{name}:1")
    return made


async def test_the_list_of_other_hosts_has_the_live_hosts_of_all_pages() -> None:
    pages: Any = Pages(record("a", b"a"), record("own", OWN), record("b", b"b", alive=False), record("c", b"c"))
    directory = MoveDirectory(pages, HostIdentity(host_id=OWN, name="own", boot_incarnation=1, zone=""))
    assert [one.name for one in await directory.other_hosts()] == ["a", "c"]


class Owners:
    """A directory with some channels, all at one host. `is_older`: it does not know `ListOwners`."""

    def __init__(self, *channel_ids: bytes, is_older: bool = False) -> None:
        self.channel_ids, self.is_older = channel_ids, is_older
        self.calls: list[str] = []

    async def call(self, method: str, request: Any, timeout_s: float, **_: Any) -> Any:
        self.calls.append(method)
        if method == "ResolveChannel":
            if request.channel_id not in self.channel_ids:
                raise ChannelNotFound("it is gone")
            return pb.ResolveChannelResponse(channel=self.channel(request.channel_id), host=record("a", b"a"))
        assert method == "ListOwners"
        if self.is_older:
            nothing = Metadata()
            cause = grpc.aio.AioRpcError(grpc.StatusCode.UNIMPLEMENTED, nothing, nothing, "Method not found!")
            raise StampedeError("Method not found!") from cause
        known = [self.channel(one) for one in request.channel_ids if one in self.channel_ids]
        return moves_pb.ListOwnersResponse(channels=known, hosts=[record("a", b"a")])

    def channel(self, channel_id: bytes) -> channel_pb2.ChannelRecord:
        return channel_pb2.ChannelRecord(channel_id=channel_id, name="cam", host_id=b"a", epoch=3)


@pytest.mark.parametrize("is_older", [False, True])
async def test_a_host_asks_for_all_owners_in_one_call_and_asks_an_older_supernode_in_one_call_for_each_channel(
    is_older: bool,
) -> None:
    owners: Any = Owners(b"1", b"2", is_older=is_older)
    directory = MoveDirectory(owners, HostIdentity(host_id=OWN, name="own", boot_incarnation=1, zone=""))
    found = await directory.owners_of([b"1", b"gone", b"2"])
    assert [(one.channel_id, source) for one, source in found] == [
        (b"1", FeedSource(b"a", "a:1", 3)),
        (b"2", FeedSource(b"a", "a:1", 3)),
    ]
    assert owners.calls == ["ListOwners", *["ResolveChannel"] * 3 * is_older]
