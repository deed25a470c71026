"""Clients need a front-end only at their start: connected clients continue without any front-end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._sync.endpoints import EndpointPool
from stampede_rt.security.credentials import Credentials, read_secret
from stampede_rt.v1.frontend_service_pb2 import BindRequest, BindResponse
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(scope="function", hosts=2, supernodes=3, frontends=2)


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def bind_response(cluster: LocalCluster, address: str) -> BindResponse:
    ports = EndpointPool(Credentials(secret=read_secret(cluster.secret_file)))
    try:
        port = ports.to(address)
        response: BindResponse = port.call(port.frontend.Bind, BindRequest(protocol_version=1), 20.0)
    finally:
        ports.close()
    return response


def test_clients_reach_new_channels_hosts_and_supernodes_without_front_ends(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    first, second = (bind_response(cluster, address) for address in cluster.address.split(","))
    assert (first.cluster_id, ids(first)) == (second.cluster_id, ids(second))
    assert ids(first) == ["s1", "s2", "s3"]

    channel = rt.channel("bound/before", max_age="1h", host="h1")
    channel.put(b"before")
    with channel.subscribe() as items:
        reader = iter(items)
        for frontend in cluster.frontends:
            frontend.stop()
        channel.put(b"after")
        assert next(reader).payload == b"after"
    assert [item.payload for item in channel.get(st.OLDEST, st.NEWEST)] == [b"before", b"after"]

    # No client has used this name yet. The supernodes are known, so no front-end is needed.
    other = rt.channel("bound/after", max_age="1h", host="h2")
    other.put(b"new")
    assert [item.payload for item in other.get(st.OLDEST, st.NEWEST)] == [b"new"]

    # The client has cached the owner. The new channel of that name has another owner, so the client must ask again.
    other.delete()
    moved_channel = rt.channel("bound/after", max_age="1h", host="h1")
    moved_channel.put(b"elsewhere")
    assert [item.payload for item in moved_channel.get(st.OLDEST, st.NEWEST)] == [b"elsewhere"]

    # End the supernode that the client asks first, too: the next one by distance takes over.
    for supernode in cluster.supernodes[:1]:
        supernode.kill()
    rt.channel("bound/later", max_age="1h").put(b"later")
    cluster.supernodes[0].start()
    cluster.supernodes[0].wait_ready(40)
    cluster.supernodes[1].kill()
    rt.channel("bound/last", max_age="1h").put(b"last")

    # One front-end that returns is enough for a new client.
    cluster.frontends[1].start()
    cluster.frontends[1].wait_ready(40)
    with st.connect(cluster.address) as newcomer:
        assert names(newcomer.channels("bound/*")) == ["bound/after", "bound/before", "bound/last", "bound/later"]


def ids(response: BindResponse) -> list[str]:
    return sorted(record.supernode_id for record in response.supernodes)


def names(channels: Any) -> list[str]:
    return sorted(channel.name for channel in channels)
