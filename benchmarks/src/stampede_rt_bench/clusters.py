"""Starts a cluster for one benchmark, with a process for every host, and connects to it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.namespaces import NamespaceNetwork

SECRET_VARIABLE = "STAMPEDE_SECRET_FILE"


@contextmanager
def running(*, hosts: int = 1, network: NamespaceNetwork | None = None) -> Iterator[str]:
    """Yield the address of a new cluster of one supernode and `hosts` hosts. It ends with the context.

    The cluster is on this machine's loopback. With a `network` the hosts are in its first namespaces, and all other
    services are in the namespace of this process. This process and its children find the secret by themselves.
    """
    with cluster_of(hosts, network) as cluster, secret_found(cluster):
        yield cluster.address


@contextmanager
def secret_found(cluster: LocalCluster) -> Iterator[None]:
    """Let this process and its children find the secret of the cluster by themselves until the end of the context."""
    before = os.environ.get(SECRET_VARIABLE)
    os.environ[SECRET_VARIABLE] = str(cluster.secret_file)
    try:
        yield
    finally:
        if before is None:
            del os.environ[SECRET_VARIABLE]
        else:
            os.environ[SECRET_VARIABLE] = before


def cluster_of(hosts: int, network: NamespaceNetwork | None) -> LocalCluster:
    """Return a cluster as in `running`, which has not started yet."""
    if network is None:
        return LocalCluster(hosts=hosts, supernodes=1, durable=False)
    return LocalCluster(
        hosts=hosts,
        supernodes=1,
        durable=False,
        listen=f"{network.address}:0",
        host_namespaces=network.namespaces[:hosts],
        allow_insecure_anywhere=True,  # the network does not leave this machine
    )


@contextmanager
def connected(*, hosts: int = 1) -> Iterator[st.Connection]:
    """Yield a connection over gRPC to a new cluster of one supernode and `hosts` hosts. Both end with the context."""
    with running(hosts=hosts) as address, st.connect(address, transport="grpc") as rt:
        yield rt
