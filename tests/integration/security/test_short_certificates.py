"""Certificates that end during use: a caller that renews its certificate goes on, and other callers get an error."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from datetime import timedelta
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import from_rpc_error
from stampede_rt.transports import futexes, ring_mapping
from stampede_rt.v1 import directory_service_pb2, directory_service_pb2_grpc
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from tests.contract.queues.rig import Rig
from tests.contract.test_renewed_tokens import WaitingCalls, ticking
from tests.integration.client.test_shared_memory import mapping_of
from tests.support.waiting import wait_until

SHORT = timedelta(seconds=4)


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(tls=True, hosts=1, supernodes=1, durable=False, data_ports=True) as made:
        yield made


@pytest.fixture
def certificates(cluster: LocalCluster) -> ClusterCertificates:
    assert cluster.certificates is not None
    return cluster.certificates


@pytest.fixture(params=["grpc", "socket", "tcp"])
def transport(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The transport of each client of a test."""
    monkeypatch.setenv("STAMPEDE_TRANSPORT", request.param)
    return str(request.param)


def test_streams_end_with_their_certificate_and_continue_with_the_renewed_one(
    cluster: LocalCluster, certificates: ClusterCertificates, transport: str
) -> None:
    files = certificates.issue(Role.CLIENT, "cam", lifetime=SHORT)
    with st.connect(cluster.address, tls=files) as rt, rt.queue("jobs") as jobs:
        channel = rt.channel("video")
        with channel.subscribe() as items:
            channel.put(b"first")
            assert next(items).payload == b"first"
            assert channel.stats().transport == transport
            assert jobs.get(timeout=0) is None
            certificates.issue(Role.CLIENT, "cam")
            payloads: list[bytes] = []

            def used_and_reconnected() -> int:
                channel.put(b"next")
                jobs.put(b"job")
                message = jobs.get(timeout=10)
                assert message is not None
                message.ack()
                payloads.append(next(items).payload)
                return items.reconnects

            wait_until(used_and_reconnected, "the subscription has come back over a new connection")
            assert set(payloads) == {b"next"}


async def test_waiting_calls_continue_with_the_renewed_certificate(
    cluster: LocalCluster, certificates: ClusterCertificates
) -> None:
    rig = Rig(cluster.address, None)
    own = await rig.connect(tls=cluster.tls_files())
    files, ends = certificates.issue(Role.CLIENT, "waits", lifetime=SHORT), st.now() + SHORT.total_seconds() * 10**9
    # Through shared memory a subscription has no connection that ends with the certificate.
    rt, peer = await rig.connect(tls=files, transport="socket"), await rig.connect(tls=files, name=rig.name())
    await peer.mailbox.get(timeout=0)
    waits = WaitingCalls(rig, rt, peer)
    async with asyncio.timeout(50):
        await waits.begin()
        certificates.issue(Role.CLIENT, "waits")
        # A host looks for ended certificates each second.
        await ticking(own, rt, f"{waits.name}/tick", ends + 1.5 * 10**9)
        assert not [kind for kind, one in waits.waiting.items() if one.done()]
        await waits.bring(own, tls=cluster.tls_files())
        await waits.check()
    await waits.close()
    for connection in rig.connections:
        await connection.aclose()


@pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")
def test_a_ring_ends_with_the_certificate_of_a_reader_and_is_shared_again_with_the_renewed_one(
    cluster: LocalCluster, certificates: ClusterCertificates
) -> None:
    files = certificates.issue(Role.CLIENT, "reads", lifetime=SHORT)
    with (
        st.connect(cluster.address, tls=files, transport="shared") as rt,
        st.connect(cluster.address, tls=cluster.tls_files(), transport="shared") as other,
    ):
        channel, others = rt.channel("ring"), other.channel("ring")
        first = others.put(b"first")
        assert channel.newest() == others.newest() == first._replace(end=None)
        rings = [mapping_of(one) for one in (channel, others)]
        certificates.issue(Role.CLIENT, "reads")
        wait_until(lambda: not any(one.is_open(ring_mapping.boottime_nanos()) for one in rings))
        later = others.put(b"later")
        assert b"later" not in bytes(rings[0]._memory)
        for one in (channel, others):
            wait_until(lambda one=one: one.newest() == later._replace(end=None) and mapping_of(one).may_be_open)
            assert one.stats().transport == "shared"


def test_every_call_on_a_connection_with_an_expired_certificate_is_refused(
    cluster: LocalCluster, certificates: ClusterCertificates
) -> None:
    files = certificates.issue(Role.CLIENT, "late", lifetime=SHORT)
    request = directory_service_pb2.ListHostsRequest()

    async def asked_until_refused() -> st.StampedeError:
        async with dial(cluster.supernodes[0].address, secret=None, tls=TlsReader(files)) as channel:
            stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(channel)
            calls = 0
            while True:  # each call is a round trip on one connection
                try:
                    await stub.ListHosts(request, timeout=10)
                    calls += 1
                except grpc.aio.AioRpcError as error:
                    assert calls
                    return from_rpc_error(error, "it")

    refused = asyncio.run(asked_until_refused())
    assert isinstance(refused, st.Unavailable)
    assert refused.reason == "CERTIFICATE_EXPIRED"
    assert "the certificate of client late has expired; renew it" in refused.message
