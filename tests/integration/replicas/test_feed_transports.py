"""The feeds of replicas go over sockets, with the security of gRPC."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually
from tests.support.cluster import SECRET_VARIABLE


@pytest.fixture
def secured(feeds: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    """A cluster with certificates and without a secret, whose hosts have TCP ports, too."""
    monkeypatch.delenv(SECRET_VARIABLE, raising=False)
    with LocalCluster(tls=True, hosts=2, supernodes=1, durable=False, data_ports=True, feed_transport=feeds) as made:
        yield made


@pytest.mark.parametrize(("feeds", "used"), [("best", "socket"), ("tcp", "tcp")], indirect=["feeds"])
def test_with_certificates_feeds_use_the_sockets_of_the_other_host_and_nothing_is_lost(
    secured: LocalCluster, used: str
) -> None:
    with st.connect(secured.address, tls=secured.tls_files()) as rt:
        channel = rt.channel("cam", host="h1", replicas=1, ack="replica")
        queue = rt.queue("jobs", host="h1", replicas=1, ack="replica", min_replicas=0)
        eventually(lambda: [one.in_sync for one in channel.stats().copies] == [True], "the replica is in sync")
        eventually(
            lambda: [one.in_sync for one in queue.stats().replicas] == [True], "the queue's replica is in sync, too"
        )
        assert channel.put(bytes(300_000)).copies == queue.put(b"work").copies == 2
        owner, copy = secured.hosts
        for process in (owner, copy):
            [began] = [line for line in process.last_lines if "host_stream_began" in line]
            assert f"transport={used}" in began
        owner.kill()
        assert channel.get(st.OLDEST, st.NEWEST)[0].payload == bytes(300_000)
        message = queue.get(timeout=20)
        assert message is not None
        assert message.payload == b"work"
