"""Which callers a supernode serves: callers of its own cluster, callers of a cluster that its own cluster replaced, and
callers that name no cluster. It refuses callers of any other cluster.
"""

from __future__ import annotations

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.errors import StampedeError, Unavailable, WrongCluster
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_supernode.codecs.command_codec import encode_command
from stampede_rt_supernode.core.cluster.commands import BeginTenure
from stampede_rt_supernode.core.commands import Command
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers.own_cluster import OwnCluster
from tests.support.supernode.node import reason_of, running_node
from tests.support.supernode.operations import TTL_NANOS, id_of


def begin(replica: DirectoryReplica, tenure: int, cluster_id: str, **how: bool) -> None:
    operation = BeginTenure(
        tenure=tenure, supernode_id="s1", new_cluster_id=cluster_id, new_lease_ttl_nanos=TTL_NANOS, **how
    )
    command = encode_command(Command(op_id=id_of(tenure), time_unix_nano=tenure, operation=operation))
    replica.apply(tenure, command)


def judged(own: OwnCluster, callers: str) -> type[StampedeError] | None:
    error = own.judge(callers)
    return None if error is None else type(error)


def test_no_caller_is_served_before_the_restored_cluster_has_its_new_id() -> None:
    replica = DirectoryReplica()
    own = OwnCluster(replica)
    assert judged(own, "x") is Unavailable
    own.learn("y")
    assert (own.id(), judged(own, "y")) == ("y", Unavailable)
    begin(replica, 1, "x")
    assert (judged(own, "x"), judged(own, "y")) == (Unavailable, Unavailable)
    begin(replica, 2, "y", founded_anew=True)
    assert (judged(own, "x"), judged(own, "y")) == (WrongCluster, None)


def test_callers_of_the_cluster_that_this_one_replaced_are_served() -> None:
    replica = DirectoryReplica()
    own = OwnCluster(replica)
    own.learn("y")
    begin(replica, 1, "x")
    begin(replica, 2, "y", founded_anew=True, takes_over=True)
    assert (judged(own, "x"), judged(own, "z")) == (None, WrongCluster)


def test_a_cluster_that_was_founded_by_a_list_learns_its_id_from_the_directory() -> None:
    replica = DirectoryReplica()
    own = OwnCluster(replica)
    own.learn("listed-0123")
    begin(replica, 1, "x")
    assert (own.id(), judged(own, "x"), judged(own, "y")) == ("x", None, WrongCluster)


async def test_a_caller_of_another_cluster_may_only_ping_and_one_that_names_no_cluster_is_served() -> None:
    async with running_node() as node:
        other, own = cluster_metadata("another"), cluster_metadata(node.replica.read(lambda one: one.cluster_id))
        pong = await node.stub.Ping(pb.DirectoryServicePingRequest(), metadata=other, timeout=10)
        assert pong.cluster_id == own[0][1]
        for make in (
            lambda metadata: node.stub.ListHosts(pb.ListHostsRequest(), metadata=metadata, timeout=10),
            lambda metadata: node.stub.OpenChannel(
                pb.OpenChannelRequest(request_id=id_of(1), name="cam", create=True), metadata=metadata, timeout=10
            ),
        ):
            refused = await reason_of(make(other))
            assert (refused.reason, refused.metadata) == ("WRONG_CLUSTER", {"cluster_id": own[0][1]})
        watch = node.stub.Watch(pb.WatchRequest(), metadata=other, timeout=10)
        assert (await reason_of(watch.read())).reason == "WRONG_CLUSTER"
        for metadata in (own, ()):
            await node.call(node.stub.ListHosts(pb.ListHostsRequest(), metadata=metadata, timeout=10))
        assert not node.replica.read(lambda one: list(one.tables.channels))
