"""Server reflection on request, as grpcurl uses it."""

from __future__ import annotations

import grpc
import pytest
from google.protobuf.descriptor_pool import DescriptorPool
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

from stampede_rt.security.credentials import call_metadata
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.server import serving
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=1, supernodes=1, reflection=True)


class WithSecret(grpc.UnaryUnaryClientInterceptor, grpc.StreamStreamClientInterceptor):  # type: ignore[misc, unused-ignore]
    """Adds the secret to each call."""

    def __init__(self, secret: str) -> None:
        self._metadata = call_metadata(secret)

    def intercept_unary_unary(self, continuation, details, request):  # type: ignore[no-untyped-def]
        return continuation(details._replace(metadata=self._metadata), request)

    def intercept_stream_stream(self, continuation, details, requests):  # type: ignore[no-untyped-def]
        return continuation(details._replace(metadata=self._metadata), requests)


def address_of(cluster: LocalCluster, part: str) -> str:
    process = {"host": cluster.hosts[0], "supernode": cluster.supernodes[0], "frontend": cluster.frontends[0]}[part]
    return process.wait_ready(0)


@pytest.mark.parametrize(
    ("part", "service", "method"),
    [
        ("host", "stampede_rt.v1.ChannelService", "Put"),
        ("supernode", "stampede_rt.v1.DirectoryService", "OpenChannel"),
        ("frontend", "stampede_rt.v1.FrontendService", "Bind"),
    ],
)
def test_a_tool_without_proto_files_finds_every_service_and_its_methods(
    cluster: LocalCluster, part: str, service: str, method: str
) -> None:
    plain = grpc.insecure_channel(address_of(cluster, part))
    with grpc.intercept_channel(plain, WithSecret(cluster.secret.text)) as channel:
        found = ProtoReflectionDescriptorDatabase(channel)
        assert {service, "grpc.health.v1.Health"} <= set(found.get_services())
        described = DescriptorPool(found).FindServiceByName(service)
        assert method in described.methods_by_name
        for name in found.get_services():
            assert DescriptorPool(found).FindServiceByName(name).methods


def test_a_caller_without_a_credential_gets_no_description(cluster: LocalCluster) -> None:
    with grpc.insecure_channel(address_of(cluster, "host")) as channel:
        with pytest.raises(grpc.RpcError) as caught:
            ProtoReflectionDescriptorDatabase(channel).get_services()
        assert caught.value.code() in (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED)


async def test_a_server_without_the_setting_does_not_describe_its_services() -> None:
    async with serving(lambda server: None) as server, grpc.aio.insecure_channel(server.address) as channel:
        call = channel.stream_stream("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo")(timeout=10)
        assert await call.code() is grpc.StatusCode.UNIMPLEMENTED
