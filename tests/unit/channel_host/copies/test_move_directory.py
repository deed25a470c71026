"""The questions of a host to the directory about moves."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.copies.move_directory import MoveDirectory

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
