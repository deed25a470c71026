"""Services of a secured cluster: the callers that they believe, the hosts that they admit, and random bytes at their
ports.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import random
import socket
import ssl
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import from_error_message
from stampede_rt.v1 import (
    directory_pb2,
    directory_service_pb2,
    directory_service_pb2_grpc,
    item_pb2,
    membership_service_pb2,
    membership_service_pb2_grpc,
    migration_directory_service_pb2_grpc,
    migration_service_pb2_grpc,
    queue_pb2,
    raft_service_pb2_grpc,
    replica_service_pb2_grpc,
)
from stampede_rt.v1 import migration_directory_service_pb2 as moves_pb
from stampede_rt.v1 import migration_service_pb2 as migration_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.v1 import raft_service_pb2 as raft_pb
from stampede_rt.v1 import replica_service_pb2 as replica_pb
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed, ServiceProcess
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL
from tests.support.certificates import ask
from tests.support.cluster import secured_cluster_fixture
from tests.support.waiting import wait_until

PATIENCE_SECONDS = 20.0

cluster = secured_cluster_fixture(hosts=1, supernodes=2)


@pytest.fixture
def certificates(cluster: LocalCluster) -> ClusterCertificates:
    assert cluster.certificates is not None
    return cluster.certificates


@pytest.fixture
def foreign(tmp_path: Path) -> ClusterCertificates:
    return ClusterCertificates(tmp_path / "foreign")


def registering(name: str) -> Callable[[grpc.aio.Channel], Any]:
    request = directory_service_pb2.RegisterHostRequest(
        request_id=os.urandom(16),
        host_id=name.encode().ljust(16, b"."),
        name=name,
        gatekeepers=[directory_pb2.Endpoint(target="localhost:1")],
        boot_incarnation=1,
        version="0.1.0",
        protocol_version=1,
    )
    return lambda channel: directory_service_pb2_grpc.DirectoryServiceStub(channel).RegisterHost(request, timeout=5)


def leaving(name: str) -> Callable[[grpc.aio.Channel], Any]:
    request = directory_service_pb2.DeregisterHostRequest(
        request_id=os.urandom(16), host_id=name.encode().ljust(16, b"."), boot_incarnation=1
    )
    return lambda channel: directory_service_pb2_grpc.DirectoryServiceStub(channel).DeregisterHost(request, timeout=5)


async def knock(channel: grpc.aio.Channel) -> None:
    """Open a member's stream without a message.

    A caller without the right is refused before the server reads anything.
    """
    call: Any = raft_service_pb2_grpc.RaftServiceStub(channel).Exchange(timeout=5)
    await call.read()
    raise AssertionError(f"the stream ended without a reason: {await call.code()}")


def greeting(member: str, to: str) -> Callable[[grpc.aio.Channel], Any]:
    hello = raft_pb.RaftHello(
        protocol_version=2, member_id=member, peer_member_id=to, highest_feature_level=HIGHEST_LEVEL
    )

    async def greet(channel: grpc.aio.Channel) -> None:
        call: Any = raft_service_pb2_grpc.RaftServiceStub(channel).Exchange(timeout=5)
        await call.write(raft_pb.RaftServiceExchangeRequest(hello=hello))
        await call.read()
        raise AssertionError(f"the stream was not refused: {await call.code()}")

    return greet


def test_only_a_host_registers_and_only_under_its_own_name(cluster: LocalCluster) -> None:
    supernode = cluster.supernodes[0].address
    error = ask(supernode, cluster.tls_files("cam"), registering("cam"))
    assert error.startswith("PERMISSION_DENIED: client cam may not call DirectoryService/RegisterHost")
    error = ask(supernode, cluster.tls_files("h9", Role.HOST), registering("h1"))
    assert error.startswith("PERMISSION_DENIED: host h9 of cluster local cannot speak for host h1")
    assert ask(supernode, cluster.tls_files("h9", Role.HOST), registering("h9")) == ""
    assert ask(supernode, cluster.tls_files("h9", Role.HOST), leaving("h9")) == ""


def test_a_host_cannot_end_or_prolong_the_lease_of_another(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        (h1,) = [one for one in rt.hosts() if one.name == "h1"]
    for name in ("RenewHostLease", "DeregisterHost"):
        kind = getattr(directory_service_pb2, f"{name}Request")
        request = kind(host_id=h1.host_id, boot_incarnation=1)

        def call(channel: grpc.aio.Channel, name: str = name, request: Any = request) -> Any:
            return getattr(directory_service_pb2_grpc.DirectoryServiceStub(channel), name)(request, timeout=5)

        error = ask(cluster.supernodes[0].address, cluster.tls_files("h9", Role.HOST), call)
        assert error.startswith("PERMISSION_DENIED: host h9 of cluster local cannot speak for host h1"), name


@pytest.mark.parametrize("is_move", [False, True])
def test_a_host_cannot_open_a_feed_under_the_id_of_another_host(cluster: LocalCluster, is_move: bool) -> None:
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        (h1,) = [one for one in rt.hosts() if one.name == "h1"]
        channel_id = rt.channel("fed/claimed").info.channel_id
    opening = replica_pb.FeedOpen(
        channel_id=channel_id, epoch=1, host_id=h1.host_id, target="localhost:1", owner_facts=True,
        move_id=b"m" * 16 if is_move else b"",
    )  # fmt: skip

    async def feed(channel: grpc.aio.Channel) -> None:
        call: Any = replica_service_pb2_grpc.ReplicaServiceStub(channel).Feed(timeout=5)
        await call.write(replica_pb.FeedRequest(open=opening, credit_bytes=1000))
        await call.read()
        raise AssertionError(f"the feed was not refused: {await call.code()}")

    error = ask(cluster.hosts[0].address, cluster.tls_files("h9", Role.HOST), feed)
    assert error.startswith("PERMISSION_DENIED: host h9 of cluster local cannot act as host h1: its certificate must")
    opening.host_id = b"n" * 16
    error = ask(cluster.hosts[0].address, cluster.tls_files("h9", Role.HOST), feed)
    assert error.startswith("NOT_FOUND: ")


def test_a_replica_of_a_queue_is_fed_only_by_the_owner_that_the_certificate_names(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        (h1,) = [one for one in rt.hosts() if one.name == "h1"]
        queue = rt.queue("fed/queue")
        record = queue_pb2.QueueRecord(queue_id=queue.info.queue_id, epoch=queue.info.epoch, host_id=h1.host_id)
        first = migration_pb.FeedQueueRequest(owner_host_id=h1.host_id, queue=record)

        async def feed(channel: grpc.aio.Channel) -> None:
            call: Any = migration_service_pb2_grpc.MigrationServiceStub(channel).FeedQueue(iter([first]), timeout=5)
            await call.read()
            raise AssertionError(f"the feed was not refused: {await call.code()}")

        address = cluster.hosts[0].address
        error = ask(address, cluster.tls_files("cam"), feed)
        assert error.startswith("PERMISSION_DENIED: client cam may not call MigrationService/FeedQueue")
        error = ask(address, cluster.tls_files("h9", Role.HOST), feed)
        assert error.startswith("PERMISSION_DENIED: host h9 of cluster local cannot act as host h1: its certificate")
        # The certificate is right, but no replica is here.
        error = ask(address, cluster.tls_files("h1", Role.HOST), feed)
        assert error.startswith("FAILED_PRECONDITION: ")
        first.owner_host_id = b"short"
        assert ask(address, cluster.tls_files("h9", Role.HOST), feed).startswith("INVALID_ARGUMENT: ")
        assert queue.put(b"kept").copies == 1


def test_a_queue_is_handed_over_only_to_the_host_that_the_certificate_names(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        (h1,) = [one for one in rt.hosts() if one.name == "h1"]
        queue = rt.queue("handed/over")
        opening = migration_pb.HandOverQueueOpen(
            queue_id=queue.info.queue_id, epoch=queue.info.epoch, host_id=h1.host_id
        )

        async def take_over(channel: grpc.aio.Channel) -> None:
            call: Any = migration_service_pb2_grpc.MigrationServiceStub(channel).HandOverQueue(timeout=5)
            await call.write(migration_pb.HandOverQueueRequest(open=opening))
            await call.read()
            raise AssertionError(f"the queue was not kept: {await call.code()}")

        address = cluster.hosts[0].address
        error = ask(address, cluster.tls_files("cam"), take_over)
        assert error.startswith("PERMISSION_DENIED: client cam may not call MigrationService/HandOverQueue")
        error = ask(address, cluster.tls_files("h9", Role.HOST), take_over)
        assert error.startswith("PERMISSION_DENIED: host h9 of cluster local cannot act as host h1: its certificate")
        opening.host_id = b"n" * 16
        assert ask(address, cluster.tls_files("h9", Role.HOST), take_over).startswith("NOT_FOUND: ")
        queue.put(b"kept")
        assert queue.get().payload == b"kept"


def test_a_host_cannot_claim_a_channel_of_another_host(cluster: LocalCluster) -> None:
    supernode, own = cluster.supernodes[0].address, cluster.tls_files("h9", Role.HOST)
    assert ask(supernode, own, registering("h9")) == ""
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        info = rt.channel("moved/by/nobody", host="h1").info
        (h9,) = [one for one in rt.hosts() if one.name == "h9"]
        allow = migration_pb.AllowMoveRequest(channel_id=info.channel_id, to_host_id=h9.host_id)
        commit = moves_pb.CommitMoveRequest(
            request_id=os.urandom(16), channel_id=info.channel_id, epoch=info.epoch, to_host_id=h9.host_id,
            to_boot_incarnation=1, permit=bytes(32),
        )  # fmt: skip
        opening = replica_pb.FeedOpen(
            channel_id=info.channel_id, epoch=info.epoch, host_id=h9.host_id, target="localhost:1", owner_facts=True,
            move_id=b"m" * 16,
        )  # fmt: skip

        async def feed(channel: grpc.aio.Channel) -> None:
            call: Any = replica_service_pb2_grpc.ReplicaServiceStub(channel).Feed(timeout=5)
            await call.write(replica_pb.FeedRequest(open=opening, hold=True, credit_bytes=1000))
            await call.read()
            raise AssertionError(f"the feed was not refused: {await call.code()}")

        def moves(channel: grpc.aio.Channel) -> Any:
            return migration_service_pb2_grpc.MigrationServiceStub(channel).AllowMove(allow, timeout=5)

        def commits(channel: grpc.aio.Channel) -> Any:
            stub = migration_directory_service_pb2_grpc.MigrationDirectoryServiceStub(channel)
            return stub.CommitMove(commit, timeout=5)

        owner = cluster.hosts[0].address
        assert ask(owner, own, moves).startswith("PERMISSION_DENIED: host h9 may not move channels or queues of")
        assert ask(owner, own, feed).startswith("PERMISSION_DENIED: no caller has asked this host to hand channel")
        assert ask(supernode, own, commits).startswith("PERMISSION_DENIED: host h9 cannot own channel moved/by/nobody")
        commit.permit = bytes(1000)
        assert ask(supernode, own, commits).startswith("INVALID_ARGUMENT: the permit of a move has 32 bytes or none")
        assert rt.channel("moved/by/nobody").info.host == "h1"
    assert ask(supernode, own, leaving("h9")) == ""


def test_a_supernode_neither_adds_nor_removes_another(cluster: LocalCluster) -> None:
    """Otherwise it could remove the others one by one, and then decide alone about the directory."""
    own = cluster.tls_files("s9", Role.SUPERNODE)
    remove = membership_service_pb2.RemoveSupernodeRequest(supernode_id="s1")
    add = membership_service_pb2.AddSupernodeRequest(supernode_id="s8", protocol_version=1)
    for name, request in (("RemoveSupernode", remove), ("AddSupernode", add)):

        def call(channel: grpc.aio.Channel, name: str = name, request: Any = request) -> Any:
            return getattr(membership_service_pb2_grpc.MembershipServiceStub(channel), name)(request, timeout=5)

        error = ask(cluster.supernodes[0].address, own, call)
        refused = "PERMISSION_DENIED: supernode s9 of cluster local may not add or remove supernode"
        assert error.startswith(refused), error


def test_only_the_member_that_a_certificate_names_opens_its_stream(cluster: LocalCluster) -> None:
    first = cluster.supernodes[0].address
    error = ask(first, cluster.tls_files("h9", Role.HOST), knock)
    assert error.startswith("PERMISSION_DENIED: host h9 may not call RaftService/Exchange, which is for supernode")
    error = ask(first, cluster.tls_files("s9", Role.SUPERNODE), greeting("s2", "s1"))
    assert "'s2' uses the certificate of supernode s9 of cluster local" in error


@pytest.mark.parametrize(
    ("role", "name", "complaint"),
    [
        (Role.CLIENT, "cam", "belongs to client cam of cluster local, but this service is a host"),
        (Role.HOST, "h7", "--name is 'h8', but the certificate"),
        (None, "foreign", "is of an authority that"),
        (None, "", "asks for certificates (TLS), and this caller has none"),
    ],
)
def test_a_refused_host_exits_with_one_sentence(
    role: Role | None, name: str, complaint: str, cluster: LocalCluster, foreign: ClusterCertificates
) -> None:
    files = cluster.tls_files(name, role) if role else foreign.issue(Role.HOST, "h8") if name else None
    words = ["--frontend", cluster.address, "--name", "h8"]
    if files is not None:
        ca, certificate, key = map(str, files.paths())
        words += ["--tls-ca", ca, "--tls-certificate", certificate, "--tls-key", key]
    host = ServiceProcess("host h8", "stampede_rt_channel_host", words)
    host.start()
    with pytest.raises(ServiceFailed):
        host.wait_ready(30)
    host.stop()
    assert host.exit_code == 1
    assert complaint in host.last_lines[-1]
    assert host.last_lines[-1].startswith("stampede host: ")
    assert not any("Traceback" in line for line in host.last_lines)


def test_a_host_in_a_shell_with_a_clients_certificates_uses_the_certificates_of_its_own_file(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    clients, own = cluster.tls_files("shell"), cluster.tls_files("h7", Role.HOST)
    assert clients is not None
    assert own is not None
    for variable, path in zip(("CA", "CERTIFICATE", "KEY"), clients.paths(), strict=True):
        monkeypatch.setenv(f"STAMPEDE_TLS_{variable}", str(path))
    settings = zip(("tls-ca", "tls-certificate", "tls-key"), own.paths(), strict=True)
    config = tmp_path / "host.toml"
    config.write_text("[host]\n" + "".join(f'{name} = "{path}"\n' for name, path in settings))
    words = ["--config", str(config), "--frontend", cluster.address]
    host = ServiceProcess("host h7", "stampede_rt_channel_host", words)
    host.start()
    try:
        host.wait_ready(30)
    finally:
        host.stop()
    assert host.exit_code == 0


class FileMakingPickle:
    """A pickle that makes a file when it is loaded."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return (os.mkdir, (str(self.place),))


def send(address: str, data: bytes, context: ssl.SSLContext | None) -> None:
    """Send `data` and read until the other side closes the connection, for one second at most."""
    host, _, port = address.rpartition(":")
    with contextlib.suppress(OSError):  # the server closed the connection, as it should
        plain = socket.create_connection((host, int(port)), 5)
        plain.settimeout(1)
        with plain, context.wrap_socket(plain, server_hostname=host) if context else plain as stream:
            stream.sendall(data)
            while stream.recv(4096):
                pass


async def send_as_messages(address: str, files: st.TlsFiles, data: bytes) -> None:
    """Send the bytes as messages of three RPCs and of an unknown one, whether the member may call them or not."""
    async with dial(address, secret=None, tls=TlsReader(files)) as channel:
        for method in ("RaftService/Exchange", "DirectoryService/RegisterHost", "FrontendService/Bind", "No/Such"):
            call: Any = channel.stream_stream(f"/stampede_rt.v1.{method}")(iter([data]), timeout=3)
            assert await outcome(call) is not grpc.StatusCode.OK


async def outcome(call: Any) -> grpc.StatusCode:
    with contextlib.suppress(grpc.aio.AioRpcError):
        async for _ in call:
            pass
    return grpc.StatusCode(await call.code())


def test_random_bytes_and_pickles_have_no_effect_at_any_port(cluster: LocalCluster, tmp_path: Path) -> None:
    place = tmp_path / "exploded"
    bombs = [pickle.dumps(FileMakingPickle(place), protocol) for protocol in (0, 2, 5)]
    preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
    noise = [random.Random(seed).randbytes(4096) for seed in range(3)]
    member = cluster.tls_files("s1", Role.SUPERNODE)
    assert member is not None
    context = ssl.create_default_context(cafile=member.paths()[0])
    context.load_cert_chain(*member.paths()[1:])
    context.set_alpn_protocols(["h2"])
    payloads = [*bombs, *noise, *(preface + data for data in (*bombs, *noise))]
    ports = [process.address for process in cluster.processes()]
    with ThreadPoolExecutor(16) as pool:
        sent = [
            pool.submit(send, address, data, how) for address in ports for data in payloads for how in (None, context)
        ]
        for one in sent:
            one.result()
    for address in ports:
        for data in bombs:
            asyncio.run(send_as_messages(address, member, data))
    assert not place.exists()
    assert all(process.alive for process in cluster.processes())
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        channel = rt.channel("after/noise", max_age="10s")
        channel.put(b"still here")
        assert channel.newest().payload == b"still here"
    pickle.loads(bombs[0])
    assert place.exists()  # so any code that unpickles this message makes the file


@pytest.mark.parametrize(("role", "believed"), [(Role.CLIENT, False), (Role.OPERATOR, False), (Role.HOST, True)])
async def test_only_a_host_can_set_the_origin_of_a_dead_letter(
    cluster: LocalCluster, role: Role, believed: bool
) -> None:
    async with aio.connect(cluster.address, tls=cluster.tls_files("reader")) as rt:
        queue = await rt.queue(f"work/forged-{role}")
        resolve = queue_directory_pb.ResolveQueueRequest(name=queue.name)
        epoch = (await rt._session.supernodes.call("ResolveQueue", resolve, PATIENCE_SECONDS)).queue.epoch
        run = item_pb2.ItemRun(payload_length_bytes=[1], payloads=b"x")
        forged = queue_pb.EnqueueRun(first_number=1, run=run, origin=item_pb2.DeadLetterOrigin(queue_name="work/other"))
        request = queue_pb.EnqueueRequest(queue_id=queue.info.queue_id, epoch=epoch, runs=[forged])
        files = cluster.tls_files("robot", role)
        assert files is not None
        async with dial(cluster.hosts[0].address, secret=None, tls=TlsReader(files)) as channel:
            enqueue = channel.stream_stream(
                "/stampede_rt.v1.QueueService/Enqueue",
                request_serializer=queue_pb.EnqueueRequest.SerializeToString,
                response_deserializer=queue_pb.EnqueueResponse.FromString,
            )
            (ack,) = [ack async for response in enqueue(iter([request])) for ack in response.acks]
        assert ack.HasField("error") is not believed
        if not believed:
            assert from_error_message(ack.error).reason == "PERMISSION_DENIED"
            assert f"{role} robot may not set the origin of a run" in ack.error.message
            assert "only hosts forward dead letters; leave origin out" in ack.error.message
        assert (await queue.stats()).held == int(believed)


@pytest.fixture
def several_hosts(cluster: LocalCluster, certificates: ClusterCertificates) -> Iterator[ServiceProcess]:
    """`stampede host --processes 2`, with a certificate for each process."""
    for number in range(2):
        certificates.issue(Role.HOST, f"rig-{number}")
    folder = certificates.folder
    words = ["--name", "rig", "--frontend", cluster.address, "--listen", "localhost:0", "--processes", "2"]
    words += ["--tls-ca", str(certificates.ca), "--tls-certificate", str(folder / "host-rig-{process}.pem")]
    words += ["--tls-key", str(folder / "host-rig-{process}.key")]
    supervisor = ServiceProcess("hosts", "stampede_rt_channel_host", words)
    supervisor.start()
    yield supervisor
    supervisor.stop()


def test_each_of_several_host_processes_proves_its_own_name(
    cluster: LocalCluster, several_hosts: ServiceProcess
) -> None:
    with st.connect(cluster.address, tls=cluster.tls_files()) as rt:
        wait_until(
            lambda: {"rig-0", "rig-1"} <= {host.name for host in rt.hosts()},
            "both processes have registered",
            PATIENCE_SECONDS,
        )
        for name in ("rig-0", "rig-1"):
            channel = rt.channel(f"at/{name}", host=name)
            channel.put(b"in")
            newest = channel.newest()
            assert newest is not None
            assert newest.payload == b"in"


def test_several_host_processes_with_one_certificate_end_with_a_reason(
    cluster: LocalCluster, certificates: ClusterCertificates
) -> None:
    files = certificates.issue(Role.HOST, "lone-0")
    ca, certificate, key = map(str, files.paths())
    words = ["--name", "lone", "--frontend", cluster.address, "--listen", "localhost:0", "--processes", "2"]
    words += ["--tls-ca", ca, "--tls-certificate", certificate, "--tls-key", key]
    ended = subprocess.run(
        [sys.executable, "-m", "stampede_rt_channel_host", *words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode in (1, 2), ended.stderr
    assert "{process}" in ended.stderr
