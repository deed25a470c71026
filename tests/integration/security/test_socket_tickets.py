"""In a cluster with certificates, a stream over a socket has the rights of the certificate of its ticket."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.security.tls import TlsReader
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.v1 import rpc_status_pb2
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.wire.stream_frames import FrameKind
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from tests.support.raw_stream import raw_stream

GET = "/stampede_rt.v1.ChannelService/Get"


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(tls=True, hosts=1, supernodes=1, durable=False) as made:
        yield made


async def socket_of(cluster: LocalCluster, files: st.TlsFiles | None) -> pb.DataEndpoint:
    """The host's socket for a caller with this certificate."""
    async with aio.connect(cluster.address, tls=cluster.tls_files()) as rt:
        [host] = await rt.hosts()
    assert files is not None
    async with dial(host.endpoints[0], secret=None, tls=TlsReader(files)) as connection:
        stub: Any = GatekeeperServiceStub(connection)
        answer = await stub.ListDataEndpoints(pb.ListDataEndpointsRequest(machine=this_machine()))
    [endpoint] = [one for one in answer.endpoints if one.transport == pb.TRANSPORT_SOCKET]
    return endpoint  # type: ignore[no-any-return]


async def answer_to(endpoint: pb.DataEndpoint, ticket: bytes) -> tuple[int, str]:
    """The code and text with which the host ends a stream that brings this ticket; (-1, "") if it serves the stream."""
    async with raw_stream(endpoint.target) as stream:
        await stream.begin(GET, ticket=ticket)
        await stream.send(FrameKind.MESSAGE, channel_pb.GetRequest(call_id=7).SerializeToString())
        frame = await stream.frame()
        if frame is not None and frame[0] == FrameKind.MESSAGE:
            assert channel_pb.GetResponse.FromString(frame[1]).call_id == 7
            return -1, ""
        assert frame is not None, "the connection ended without a status"
        status = rpc_status_pb2.Status.FromString(frame[1])
        return status.code, status.message


async def test_only_the_ticket_of_a_certificate_opens_a_stream(cluster: LocalCluster) -> None:
    endpoint = await socket_of(cluster, cluster.tls_files("cam"))
    assert await answer_to(endpoint, endpoint.ticket) == (-1, "")
    for ticket in (b"", b"made up", endpoint.ticket[:-1], bytes(len(endpoint.ticket))):
        code, text = await answer_to(endpoint, ticket)
        assert code == grpc.StatusCode.PERMISSION_DENIED.value[0], text
        assert "must bring the ticket" in text


async def test_each_certificate_keeps_its_own_ticket(cluster: LocalCluster) -> None:
    cam, arm = cluster.tls_files("cam"), cluster.tls_files("arm")
    tickets = [(await socket_of(cluster, files)).ticket for files in (cam, arm, cam)]
    assert tickets[0] == tickets[2] != tickets[1]


@pytest.mark.parametrize("role", [Role.OPERATOR, Role.HOST])
async def test_other_roles_use_sockets_too(cluster: LocalCluster, role: Role) -> None:
    endpoint = await socket_of(cluster, cluster.tls_files("other", role))
    assert await answer_to(endpoint, endpoint.ticket) == (-1, "")


def test_a_program_sees_that_its_data_goes_over_sockets(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        assert rt.channel("seen").stats().transport == "socket"
