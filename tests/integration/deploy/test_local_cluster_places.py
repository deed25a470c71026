"""A local cluster whose hosts are in network namespaces. Clients reach the hosts from outside and from other
namespaces.
"""

from __future__ import annotations

import multiprocessing

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.namespaces import NamespaceNetwork, unavailable_because
from tests.support.cluster import running_cluster

WHY_NOT = unavailable_because()


def read_newest(address: str, name: str) -> bytes | None:
    """Read the newest item in a separate process."""
    with st.connect(address) as rt:
        item = rt.channel(name, create=False).newest()
    return None if item is None else item.payload


@pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")
def test_a_client_in_a_namespace_reads_from_a_host_in_another() -> None:
    with NamespaceNetwork(2) as network:
        host, consumer = network.namespaces
        settings = {"listen": f"{network.address}:0", "host_namespaces": [host], "allow_insecure_anywhere": True}
        with running_cluster(hosts=1, supernodes=1, durable=False, **settings) as cluster:
            assert cluster.hosts[0].address.startswith(f"{host.address}:")
            with st.connect(cluster.address) as rt:
                rt.channel("cam", max_age="10s").put(b"there")
            with multiprocessing.get_context("spawn").Pool(1, initializer=consumer.enter) as pool:
                assert pool.apply(read_newest, (cluster.address, "cam")) == b"there"


def test_certificates_are_refused_for_hosts_in_namespaces() -> None:
    with pytest.raises(ValueError, match="leave one out"):
        LocalCluster(tls=True, host_namespaces=NamespaceNetwork(1).namespaces)


@pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")
def test_two_networks_have_names_and_addresses_of_their_own() -> None:
    """In an earlier version, the name and the address came from the process id modulo 4096.

    Two processes could therefore get the same network.
    """
    with NamespaceNetwork(1) as one, NamespaceNetwork(1) as other:
        assert one.address != other.address
        assert one.namespaces[0].name != other.namespaces[0].name
    with NamespaceNetwork(1) as second:
        assert second.address == one.address, "the former networks left nothing behind"
