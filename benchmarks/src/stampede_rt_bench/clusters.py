"""A cluster of its own for a benchmark: one host as a process of its own, and a connection to it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster

SECRET_VARIABLE = "STAMPEDE_SECRET_FILE"


@contextmanager
def running(*, hosts: int = 1) -> Iterator[str]:
    """The address of a fresh cluster of one supernode and `hosts` hosts on this machine; gone afterwards.

    This process and those that it starts find the secret by themselves.
    """
    with LocalCluster(hosts=hosts, supernodes=1, durable=False) as cluster:
        before = os.environ.get(SECRET_VARIABLE)
        os.environ[SECRET_VARIABLE] = str(cluster.secret_file)
        try:
            yield cluster.address
        finally:
            if before is None:
                del os.environ[SECRET_VARIABLE]
            else:
                os.environ[SECRET_VARIABLE] = before


@contextmanager
def connected(*, hosts: int = 1) -> Iterator[st.Connection]:
    """A connection to such a cluster."""
    with running(hosts=hosts) as address, st.connect(address) as rt:
        yield rt
