"""Groups and copies over gRPC: the parts that the servicers add to the transitions."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio

from stampede_rt.v1 import channel_pb2, directory_pb2, group_pb2, replica_pb2, subject_pb2
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import group_directory_service_pb2 as groups_pb
from stampede_rt.v1 import replica_directory_service_pb2 as replicas_pb
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from tests.support.supernode.memory_log import ProposalOutcome
from tests.support.supernode.node import Node, reason_of, running_node
from tests.support.supernode.operations import id_of

PROXY, WARM = replica_pb2.REPLICA_KIND_PROXY, replica_pb2.REPLICA_KIND_WARM


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1, name="one")
        await node.register(2, name="two")
        yield node


async def two_channels(node: Node) -> tuple[bytes, bytes]:
    left, right = await node.open("left", host_name="one"), await node.open("right", host_name="two")
    return left.channel.channel_id, right.channel.channel_id


def open_request(number: int, name: str, *members: bytes, **fields: Any) -> groups_pb.OpenGroupRequest:
    spec = group_pb2.GroupSpec(channel_ids=members)
    return groups_pb.OpenGroupRequest(request_id=id_of(number), name=name, spec=spec, create=True, **fields)


async def test_a_group_is_opened_resolved_changed_listed_and_deleted(node: Node) -> None:
    left, right = await two_channels(node)
    opened = await node.groups.OpenGroup(open_request(1, "pair", right, left))
    assert opened.created
    assert [channel.name for channel in opened.channels] == ["right", "left"]
    assert [host.name for host in opened.hosts] == ["two", "one"]
    by_name = await node.groups.ResolveGroup(groups_pb.ResolveGroupRequest(name="pair"))
    by_id = await node.groups.ResolveGroup(groups_pb.ResolveGroupRequest(group_id=opened.group.group_id))
    assert by_name == by_id
    assert (by_name.group, by_name.applied_index) == (opened.group, node.log.index)
    change = groups_pb.UpdateGroupRequest(
        request_id=id_of(2), group_id=opened.group.group_id, remove_channel_ids=[left], spec_version=1
    )
    updated = await node.groups.UpdateGroup(change)
    assert (list(updated.group.spec.channel_ids), updated.group.spec_version) == ([right], 2)
    assert (await node.groups.UpdateGroup(change)) == updated, "the same request id repeats the answer"
    listed = await node.groups.ListGroups(groups_pb.ListGroupsRequest(channel_id=right))
    assert list(listed.groups) == [updated.group]
    gone = groups_pb.DeleteGroupRequest(request_id=id_of(3), group_id=opened.group.group_id)
    await node.groups.DeleteGroup(gone)
    error = await reason_of(node.groups.ResolveGroup(groups_pb.ResolveGroupRequest(name="pair")))
    assert error.reason == "GROUP_NOT_FOUND"


async def test_an_existing_group_is_opened_without_an_entry_in_the_log(node: Node) -> None:
    left, right = await two_channels(node)
    first = await node.groups.OpenGroup(open_request(1, "pair", left, right))
    index = node.log.index
    second = await node.groups.OpenGroup(open_request(2, "pair", right, left))
    assert (second.group, second.created) == (first.group, False)
    bare = groups_pb.OpenGroupRequest(request_id=id_of(3), name="pair")
    assert (await node.groups.OpenGroup(bare)).group == first.group
    assert (await reason_of(node.groups.OpenGroup(open_request(4, "pair", left)))).reason == "GROUP_EXISTS"
    repeated = await node.groups.OpenGroup(open_request(1, "pair", left, right))
    assert repeated == first, "the answer says that the group was created, as the first answer did"
    assert node.log.index == index


async def test_a_group_is_created_once_even_if_the_outcome_of_the_first_proposal_is_unknown(node: Node) -> None:
    left, _ = await two_channels(node)
    node.log.outcomes.append(ProposalOutcome.DONE_WITHOUT_ANSWER)
    opened = await node.groups.OpenGroup(open_request(1, "pair", left))
    assert opened.created
    assert len((await node.groups.ListGroups(groups_pb.ListGroupsRequest())).groups) == 1


async def test_groups_are_listed_page_by_page_and_a_token_belongs_to_its_listing(node: Node) -> None:
    left, _ = await two_channels(node)
    for number, name in enumerate(("a", "b", "c"), start=1):
        await node.groups.OpenGroup(open_request(number, name, left))
    first = await node.groups.ListGroups(groups_pb.ListGroupsRequest(page_size=2))
    token = first.next_page_token
    rest = await node.groups.ListGroups(groups_pb.ListGroupsRequest(page_size=2, page_token=token))
    assert [group.name for group in (*first.groups, *rest.groups)] == ["a", "b", "c"]
    assert rest.next_page_token == ""
    for other in ({"name_glob": "*"}, {"channel_id": left}):
        error = await reason_of(node.groups.ListGroups(groups_pb.ListGroupsRequest(page_token=token, **other)))
        assert (error.reason, "another listing" in error.message) == ("INVALID_ARGUMENT", True)


async def test_without_a_majority_only_stale_reads_answer(node: Node) -> None:
    left, _ = await two_channels(node)
    await node.groups.OpenGroup(open_request(1, "pair", left))
    node.log.quorum = False
    resolve = groups_pb.ResolveGroupRequest(name="pair")
    assert (await reason_of(node.groups.ResolveGroup(resolve, timeout=0.4))).reason == "NO_QUORUM"
    resolve.stale_ok = True
    assert (await node.groups.ResolveGroup(resolve)).group.name == "pair"


async def test_a_watch_has_groups_only_on_request_and_selects_them_by_name(node: Node) -> None:
    left, _ = await two_channels(node)
    watch = node.stub.Watch(directory_pb.WatchRequest(name_glob="p*", include_groups=True))
    without_groups = node.stub.Watch(directory_pb.WatchRequest(name_glob="p*"))
    await watch.read()
    await without_groups.read()
    await node.groups.OpenGroup(open_request(1, "other", left))
    opened = await node.groups.OpenGroup(open_request(2, "pair", left))
    await node.open("pane")
    (change,) = (await watch.read()).changes
    assert (change.kind, change.group) == (directory_pb2.CHANGE_KIND_ADDED, opened.group)
    (change,) = (await without_groups.read()).changes
    assert change.channel.name == "pane"
    watch.cancel()
    without_groups.cancel()


def subject(channel_id: bytes) -> subject_pb2.Subject:
    return subject_pb2.Subject(channel_id=channel_id)


def add_request(number: int, channel_id: bytes, **fields: Any) -> replicas_pb.AddReplicaRequest:
    fields = {"kind": PROXY, "epoch": 1, **fields}
    return replicas_pb.AddReplicaRequest(request_id=id_of(number), subject=subject(channel_id), **fields)


def load(channel_id: bytes, host: int, **fields: int) -> replica_pb2.ReplicaLoad:
    return replica_pb2.ReplicaLoad(subject=subject(channel_id), host_id=id_of(host), **fields)


def report(host: int, *loads: replica_pb2.ReplicaLoad, boot: int = 1) -> replicas_pb.ReportReplicaLoadsRequest:
    return replicas_pb.ReportReplicaLoadsRequest(host_id=id_of(host), boot_incarnation=boot, loads=loads)


async def resolved(node: Node, name: str) -> channel_pb2.ChannelRecord:
    found = await node.stub.ResolveChannel(directory_pb.ResolveChannelRequest(name=name))
    record: channel_pb2.ChannelRecord = found.channel
    return record


async def test_a_copy_is_added_listed_and_removed(node: Node) -> None:
    left, _ = await two_channels(node)
    added = await node.replicas.AddReplica(add_request(1, left))
    assert (added.host.name, added.replica.host_id) == ("two", id_of(2))
    assert list((await resolved(node, "left")).proxy_host_ids) == [id_of(2)]
    listed = await node.replicas.ListReplicas(replicas_pb.ListReplicasRequest(subject=subject(left)))
    assert list(listed.replicas) == [added.replica]
    assert [host.name for host in listed.hosts] == ["one", "two"]
    assert (listed.owner_host_id, listed.epoch, listed.applied_index) == (id_of(1), 1, node.log.index)
    gone = replicas_pb.RemoveReplicaRequest(request_id=id_of(2), subject=subject(left), host_id=id_of(2))
    await node.replicas.RemoveReplica(gone)
    assert list((await resolved(node, "left")).proxy_host_ids) == []


async def test_a_copy_without_a_free_host_is_refused_without_an_entry_in_the_log(node: Node) -> None:
    """In an earlier version, each of the owner's repeated requests was an entry that all supernodes wrote to disk."""
    left, _ = await two_channels(node)
    added = await node.replicas.AddReplica(add_request(1, left, kind=WARM))
    index = node.log.index
    assert (await reason_of(node.replicas.AddReplica(add_request(2, left, kind=WARM)))).reason == "NO_HOST"
    contradicts = add_request(4, left, kind=WARM, acknowledged=True, host_id=id_of(2))
    assert (await reason_of(node.replicas.AddReplica(contradicts))).reason == "INVALID_ARGUMENT"
    wrong_epoch = add_request(3, left, kind=WARM, epoch=7)
    assert (await reason_of(node.replicas.AddReplica(wrong_epoch))).reason == "WRONG_EPOCH"
    assert node.log.index == index
    assert await node.replicas.AddReplica(add_request(1, left, kind=WARM)) == added, "the request comes again"


async def test_a_channel_passes_to_the_replica_in_sync_when_the_lease_of_its_owner_ends(node: Node) -> None:
    spec = policy_to_spec(Policy(replicas=1, ack="replica"))
    left = (await node.open("left", host_name="one", spec=spec)).channel.channel_id
    before = await resolved(node, "left")
    await node.replicas.AddReplica(add_request(1, left, kind=WARM, acknowledged=True))
    request = replicas_pb.SetReplicaInSyncRequest(
        request_id=id_of(2), subject=subject(left), epoch=1, host_id=id_of(2), boot_incarnation=1, in_sync=True
    )
    assert (await node.replicas.SetReplicaInSync(request)).replica.in_sync
    for _ in range(6):
        await node.renew(2)
        await node.pass_seconds(1)
    after = await resolved(node, "left")
    assert (after.host_id, after.epoch, list(after.proxy_host_ids)) == (id_of(2), 2, [])
    assert after.incarnation == before.incarnation


@pytest.mark.parametrize("kind", [replica_pb2.REPLICA_KIND_UNSPECIFIED, replica_pb2.REPLICA_KIND_MOVE])
async def test_an_unsupported_kind_is_refused(node: Node, kind: Any) -> None:
    left, _ = await two_channels(node)
    assert (await reason_of(node.replicas.AddReplica(add_request(1, left, kind=kind)))).reason == "INVALID_ARGUMENT"


async def test_an_unknown_queue_is_not_found_and_a_request_needs_a_subject(node: Node) -> None:
    queue = replicas_pb.ListReplicasRequest(subject=subject_pb2.Subject(queue_id=id_of(1)))
    assert (await reason_of(node.replicas.ListReplicas(queue))).reason == "QUEUE_NOT_FOUND"
    nothing = await reason_of(node.replicas.ListReplicas(replicas_pb.ListReplicasRequest()))
    assert nothing.reason == "INVALID_ARGUMENT"


async def test_loads_are_reported_to_the_leader_and_listed_the_least_loaded_first(node: Node) -> None:
    left, right = await two_channels(node)
    await node.replicas.AddReplica(add_request(1, left))
    await node.replicas.ReportReplicaLoads(report(1, load(left, 1, delivered_bytes_per_second=9)))
    await node.replicas.ReportReplicaLoads(report(2, load(left, 2, subscriptions=3), load(id_of(77), 2)))
    ask = replicas_pb.ListReplicasRequest(subject=subject(left))
    assert [one.host_id for one in (await node.replicas.ListReplicas(ask)).loads] == [id_of(2), id_of(1)]
    node.clock.advance(11 * 10**9)
    await node.replicas.ReportReplicaLoads(report(2, load(right, 2)))
    assert list((await node.replicas.ListReplicas(ask)).loads) == []
    node.log.leader_id = "s2"
    error = await reason_of(node.replicas.ReportReplicaLoads(report(1, load(left, 1))))
    assert (error.reason, error.metadata["leader"]) == ("NOT_LEADER", "s2")


async def test_loads_of_another_boot_or_host_are_refused(node: Node) -> None:
    left, _ = await two_channels(node)
    assert (await reason_of(node.replicas.ReportReplicaLoads(report(1, boot=2)))).reason == "LEASE_EXPIRED"
    assert (await reason_of(node.replicas.ReportReplicaLoads(report(7)))).reason == "LEASE_EXPIRED"
    foreign = await reason_of(node.replicas.ReportReplicaLoads(report(1, load(left, 2))))
    assert foreign.reason == "INVALID_ARGUMENT"
    many = report(1, *[load(left, 1)] * 1001)
    assert "1000 at most" in (await reason_of(node.replicas.ReportReplicaLoads(many))).message
