"""A revoked certificate: new calls with it are refused, and its open streams end."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

import stampede_rt as st
from stampede_rt.errors import PermissionDenied
from stampede_rt.security.tls import TlsFiles
from stampede_rt.v1 import frontend_service_pb2, frontend_service_pb2_grpc
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.certs_command import main as certs
from stampede_rt_runtime.identity import Role
from tests.support.certificates import ask


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(tls=True, hosts=1, supernodes=1, durable=False, data_ports=True) as made:
        yield made


def issued(cluster: LocalCluster, role: Role, name: str) -> TlsFiles:
    files = cluster.tls_files(name, role)
    assert files is not None
    return files


@pytest.fixture(params=["grpc", "socket", "tcp"])
def transport(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The transport of each client of a test."""
    monkeypatch.setenv("STAMPEDE_TRANSPORT", request.param)
    return str(request.param)


@pytest.fixture
def operator(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands of this process use the certificate of an operator."""
    files = issued(cluster, Role.OPERATOR, "ops")
    for variable, path in (("CA", files.ca), ("CERTIFICATE", files.certificate), ("KEY", files.key)):
        monkeypatch.setenv(f"STAMPEDE_TLS_{variable}", str(path))


@pytest.mark.usefixtures("operator")
def test_a_revoked_certificate_is_refused_and_its_open_streams_end(cluster: LocalCluster, transport: str) -> None:
    files = issued(cluster, Role.CLIENT, f"lost-{transport}")
    with st.connect(cluster.address, tls=files) as rt:
        channel = rt.channel("revoked")
        with channel.subscribe() as items:
            channel.put(b"x")
            assert next(items).payload == b"x"
            assert channel.stats().transport == transport
            assert certs(["revoke", str(files.certificate), "--url", cluster.address]) == 0
            with pytest.raises(PermissionDenied, match=f"of client lost-{transport} was revoked"):
                next(items)
        with pytest.raises(PermissionDenied, match=f"of client lost-{transport} was revoked"):
            rt.channel("revoked-too")


@pytest.mark.usefixtures("operator")
def test_a_front_end_ends_the_open_streams_of_a_revoked_certificate(cluster: LocalCluster) -> None:
    files = issued(cluster, Role.CLIENT, "watcher")
    bind = frontend_service_pb2.BindRequest(protocol_version=1)

    async def watch(channel: grpc.aio.Channel) -> None:
        health: Any = health_pb2_grpc.HealthStub(channel)
        call = health.Watch(health_pb2.HealthCheckRequest(), timeout=20)
        assert (await call.read()).status == health_pb2.HealthCheckResponse.SERVING
        revoke = ["revoke", str(files.certificate), "--url", cluster.address]
        assert await asyncio.to_thread(certs, revoke) == 0
        await call.read()

    async def bound(channel: grpc.aio.Channel) -> None:
        await frontend_service_pb2_grpc.FrontendServiceStub(channel).Bind(bind, timeout=10)

    assert ask(cluster.address, files, bound) == ""
    for call in (watch, bound):
        error = ask(cluster.address, files, call)
        assert error.startswith("UNAUTHENTICATED: the certificate ")
        assert "of client watcher was revoked" in error
