"""How the leader gets the reported loads of hosts into the log."""

from __future__ import annotations

from stampede_rt.v1 import directory_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_supernode.core.records import HostLoad
from tests.support.supernode.node import Node, running_node
from tests.support.supernode.operations import id_of


async def renew(node: Node, number: int, busy: int) -> None:
    load = directory_pb2.HostLoad(busy_permille=busy, bytes_max=1000)
    request = pb.RenewHostLeaseRequest(host_id=id_of(number), boot_incarnation=1, load=load)
    await node.call(node.stub.RenewHostLease(request, timeout=10))


def noted(node: Node, number: int) -> HostLoad | None:
    return node.replica.read(lambda directory: directory.tables.hosts[id_of(number)].load)


async def test_the_loads_of_all_hosts_take_one_entry_and_unchanged_loads_take_none() -> None:
    async with running_node() as node:
        for number in (1, 2, 3):
            await node.register(number)
        before = node.replica.read(lambda directory: directory.applied_index)
        for number in (1, 2, 3):
            await renew(node, number, 100 * number)
        await node.pass_seconds(3)
        assert [noted(node, one) for one in (1, 2, 3)] == [
            HostLoad(busy_permille=100 * one, bytes_max=1000) for one in (1, 2, 3)
        ]
        after = node.replica.read(lambda directory: directory.applied_index)
        assert after == before + 1
        for number in (1, 2, 3):
            await renew(node, number, 100 * number + 49)
        await node.pass_seconds(3)
        assert node.replica.read(lambda directory: directory.applied_index) == after, "the change is too small"


async def test_a_new_channel_adds_an_estimated_load_until_its_host_has_measured_it() -> None:
    async with running_node() as node:
        await node.register(1)
        await renew(node, 1, 100)
        await node.open("cam/1")
        await renew(node, 1, 100)  # measured when the channel was new
        await node.pass_seconds(3)
        load = noted(node, 1)
        assert load is not None
        assert load.owned == 0
        await renew(node, 1, 100)
        await node.pass_seconds(2)
        load = noted(node, 1)
        assert load is not None
        assert load.owned == 1
