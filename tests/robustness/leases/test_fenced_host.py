"""A channel host that was stopped for longer than its lease refuses the requests that have arrived meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import grpc
import pytest

import stampede_rt as st
from stampede_rt.errors import StampedeError
from stampede_rt.security.credentials import call_metadata
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.support.channel_host.rig import run_of

PATIENCE_SECONDS = 30.0
STALE_PUTS = 20


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    """Two hosts whose leases last 2 s."""
    made = LocalCluster(hosts=2, supernodes=1)
    made.supernodes[0].arguments.extend(("--lease-ttl", "2s"))
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(made.secret_file))
    with made:
        yield made


def owner(cluster: LocalCluster, channel: st.Channel) -> ServiceProcess:
    return next(host for host in cluster.hosts if channel.host in host.name or host.name in channel.host)


def stale_put(stub: ChannelServiceStub, cluster: LocalCluster, info: st.ChannelInfo) -> list[pb.PutAck]:
    """Put under the epoch of `info`, as a caller that does not ask the directory again. Raises StampedeError."""
    request = pb.PutRequest(channel_id=info.channel_id, epoch=info.epoch, puts=[run_of(b"too late", number=1)])
    metadata = call_metadata(cluster.secret.text)
    try:
        responses = list(stub.Put(iter((request,)), metadata=metadata, timeout=PATIENCE_SECONDS))
    except grpc.RpcError as error:
        raise from_rpc_error(error, "the stopped host") from error
    return [ack for response in responses for ack in response.acks]


def refused(answer: Future[list[pb.PutAck]]) -> bool:
    """Whether the host accepted no item of a put."""
    try:
        acks = answer.result(PATIENCE_SECONDS)
    except StampedeError:
        return True
    return all(not ack.HasField("first_seq") and ack.HasField("error") for ack in acks)


def test_a_host_that_is_resumed_after_its_lease_acknowledges_nothing_under_its_old_epoch(
    cluster: LocalCluster,
) -> None:
    with st.connect(cluster.address) as rt, st.connect(cluster.address) as other, ThreadPoolExecutor(32) as pool:
        channel = rt.channel("cam", max_age="60s")
        channel.put(b"before")
        before, stopped = channel.info, owner(cluster, channel)
        with grpc.insecure_channel(stopped.address) as connection:
            stub = ChannelServiceStub(connection)
            assert stale_put(stub, cluster, before)[0].HasField("first_seq"), (
                "the host refuses a put under a valid lease"
            )
            stopped.pause()
            try:
                waiting = [pool.submit(stale_put, stub, cluster, before) for _ in range(STALE_PUTS)]
                item = other.channel("cam").put(b"at the new owner", timeout=PATIENCE_SECONDS)
            finally:
                stopped.resume()
            assert all(refused(answer) for answer in waiting)
            assert refused(pool.submit(stale_put, stub, cluster, before))
        after = other.channel("cam").info
        assert after.epoch > before.epoch
        assert item.incarnation == after.incarnation != before.incarnation
        assert channel.put(b"its former callers find the new owner").incarnation == after.incarnation
        payloads = [one.payload for one in channel.get(st.OLDEST, st.NEWEST)]
        assert payloads == [b"at the new owner", b"its former callers find the new owner"]
