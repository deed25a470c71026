"""Clusters for test files that run one after another: `cluster = shared_cluster_fixture(hosts=2)` in each of the files.

The start of a cluster costs as much CPU time as a hundred short tests. So a file shares a cluster if its tests only use
the cluster, and never stop, freeze or configure a part of it. The files that share one cluster are called a share (see
`shares`). The cluster ends after the last test of its share. Between two files the fixture deletes all channels, queues
and groups.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import find_secret_of, print_last_lines, running_cluster
from tests.support.sharing.shares import at_end_of_share

_running: dict[int, LocalCluster] = {}  # by the number of hosts


def shared_cluster_fixture(*, hosts: int) -> Callable[..., Iterator[LocalCluster]]:
    """Return a module's fixture with a LocalCluster of one supernode and `hosts` hosts. Clients find its secret."""

    @pytest.fixture(scope="module")
    def cluster() -> Iterator[LocalCluster]:
        made = shared_cluster(hosts)
        with pytest.MonkeyPatch.context() as patch:
            find_secret_of(made, patch)
            yield made
        print_last_lines(made)
        empty(made)

    return cluster


def shared_cluster(hosts: int) -> LocalCluster:
    """Return the running cluster with that many hosts. Start it if there is none."""
    if hosts not in _running:
        made = at_end_of_share.enter_context(running_cluster(hosts=hosts, supernodes=1, is_found=False))
        at_end_of_share.callback(_running.pop, hosts)
        _running[hosts] = made
    return _running[hosts]


def empty(cluster: LocalCluster) -> None:
    """Delete all channels, queues and groups. Fails if a process of the cluster has ended."""
    assert all(process.alive for process in cluster.processes()), "a file has ended a part of a shared cluster"
    with st.connect(cluster.address, secret=cluster.secret.text) as rt:
        for group in rt.groups():
            rt.group(group.name).delete()
        # the directory deletes a dead-letter queue only if no other queue names it
        for queue in sorted(rt.queues(), key=lambda one: one.policy.dead_letter_queue_id is None):
            rt.queue(queue.name).delete()
        for channel in rt.channels():
            rt.channel(channel.name).delete()
