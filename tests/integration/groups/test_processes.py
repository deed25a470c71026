"""A group over two channel hosts that are processes of their own, with a real directory and the secret."""

from __future__ import annotations

import secrets
from collections.abc import Iterator

import grpc
import pytest

from stampede_rt.security.credentials import call_metadata, read_secret
from stampede_rt.v1 import (
    channel_pb2,
    channel_service_pb2,
    channel_service_pb2_grpc,
    directory_service_pb2,
    directory_service_pb2_grpc,
    frontend_service_pb2,
    frontend_service_pb2_grpc,
    gatekeeper_service_pb2,
    gatekeeper_service_pb2_grpc,
    group_directory_service_pb2,
    group_directory_service_pb2_grpc,
    group_pb2,
    group_service_pb2,
    group_service_pb2_grpc,
)
from stampede_rt_local.cluster import LocalCluster
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, S, between, run_of
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=2)
CALL_SECONDS_MAX = 15.0


class Member:
    """A channel at its host, through plain stubs."""

    def __init__(self, record: channel_pb2.ChannelRecord, host: grpc.Channel, metadata: object) -> None:
        self.record = record
        self._metadata = metadata
        self.channels = channel_service_pb2_grpc.ChannelServiceStub(host)
        self.groups = group_service_pb2_grpc.GroupServiceStub(host)
        gatekeeper_service_pb2_grpc.GatekeeperServiceStub(host).BindChannel(
            gatekeeper_service_pb2.BindChannelRequest(channel_id=record.channel_id, epoch=record.epoch),
            metadata=metadata,
            timeout=CALL_SECONDS_MAX,
        )

    def put(self, *times: int) -> None:
        request = channel_service_pb2.PutRequest(
            channel_id=self.record.channel_id, epoch=self.record.epoch, puts=[run_of(*[b"x"] * len(times), times=times)]
        )
        for response in self.channels.Put(iter((request,)), metadata=self._metadata, timeout=CALL_SECONDS_MAX):
            assert not [ack for ack in response.acks if ack.rejections or ack.HasField("error")]

    def get(self, group_id: bytes, floor: int) -> tuple[list[int], int]:
        """The times that the group shows once its cut has come to `floor`, and the cut."""
        request = channel_service_pb2.GetRequest(
            call_id=1,
            channel_id=self.record.channel_id,
            epoch=self.record.epoch,
            interval=between(MIN_INSTANT, MAX_INSTANT),
            group_id=group_id,
            cut_floor_unix_nano=floor,
            wait_nanos=int(CALL_SECONDS_MAX) * S,
        )
        responses = list(self.channels.Get(iter((request,)), metadata=self._metadata, timeout=2 * CALL_SECONDS_MAX))
        times = [time for one in responses for run in one.runs for time in run.run.time_unix_nano]
        return times, responses[-1].summary.cut_unix_nano


@pytest.fixture(scope="module")
def members(cluster: LocalCluster) -> Iterator[tuple[list[Member], bytes]]:
    """A channel at each host, and a group of both."""
    metadata = call_metadata(read_secret(cluster.secret_file))
    opened = [grpc.insecure_channel(cluster.address)]
    bind = frontend_service_pb2_grpc.FrontendServiceStub(opened[0]).Bind
    bound = bind(frontend_service_pb2.BindRequest(protocol_version=1), metadata=metadata, timeout=CALL_SECONDS_MAX)
    opened.append(grpc.insecure_channel(bound.supernodes[0].endpoint.target))
    directory = directory_service_pb2_grpc.DirectoryServiceStub(opened[1])
    hosts = directory.ListHosts(
        directory_service_pb2.ListHostsRequest(), metadata=metadata, timeout=CALL_SECONDS_MAX
    ).hosts
    made = []
    for number, host in enumerate(hosts):
        request = directory_service_pb2.OpenChannelRequest(
            request_id=secrets.token_bytes(16), name=f"member-{number}", create=True, host_name=host.name
        )
        record = directory.OpenChannel(request, metadata=metadata, timeout=CALL_SECONDS_MAX).channel
        opened.append(grpc.insecure_channel(host.gatekeepers[0].target))
        made.append(Member(record, opened[-1], metadata))
    spec = group_pb2.GroupSpec(channel_ids=[one.record.channel_id for one in made])
    group = (
        group_directory_service_pb2_grpc.GroupDirectoryServiceStub(opened[1])
        .OpenGroup(
            group_directory_service_pb2.OpenGroupRequest(
                request_id=secrets.token_bytes(16), name="pair", spec=spec, create=True
            ),
            metadata=metadata,
            timeout=CALL_SECONDS_MAX,
        )
        .group
    )
    yield made, group.group_id
    for channel in opened:
        channel.close()


def test_two_hosts_use_the_same_cut_of_a_group(members: tuple[list[Member], bytes]) -> None:
    (left, right), group_id = members
    now = left.groups.GetGroupStatus(
        group_service_pb2.GetGroupStatusRequest(group_id=group_id),
        metadata=left._metadata,
        timeout=CALL_SECONDS_MAX,
    ).status.host_time_unix_nano
    left.put(now, now + 20)
    right.put(now + 10, now + 30)
    assert left.get(group_id, now + 20) == ([now], now + 20)
    assert right.get(group_id, now + 20) == ([now + 10], now + 20)
    right.put(now + 40)
    left.put(now + 50)
    assert left.get(group_id, now + 40) == ([now, now + 20], now + 40)
