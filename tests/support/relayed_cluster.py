"""A cluster whose one host is reached through a relay that cuts connections."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceProcess
from tests.support.cluster import running_cluster
from tests.support.cutting_relay import CUTS, CuttingRelay

PAUSE_S_MAX = 0.25  # between cuts
REFUSES_SHARE = 0.1  # the share of cuts after which no connection succeeds for a while
READY_S = 40.0
HOST_NAME = "relayed"
INNER = "127.0.0.2"  # the address of the host itself, behind the relay


@dataclass(frozen=True, slots=True)
class RelayedCluster:
    """`host`: the name of the host behind the relay. Tests open channels and queues at this host by its name."""

    cluster: LocalCluster
    relay: CuttingRelay
    host: str = HOST_NAME

    @property
    def address(self) -> str:
        """The address for clients."""
        return self.cluster.address

    async def cut(self, rng: random.Random) -> None:
        """Cut connections at random times until this task is cancelled. Then the relay accepts connections again."""
        try:
            while True:
                await asyncio.sleep(rng.random() * PAUSE_S_MAX)
                self.relay.refuses = rng.random() < REFUSES_SHARE
                self.relay.cut(rng.choice(CUTS))
        finally:
            self.relay.refuses = False


@contextmanager
def running_relayed_cluster(hosts: int = 0, feed_transport: str = "best") -> Iterator[RelayedCluster]:
    """Yield the cluster and its relay. Both have ended after the block. `hosts`: the number of further hosts."""
    with running_cluster(hosts=hosts, supernodes=1, feed_transport=feed_transport) as cluster:
        # the host listens at another address, because the relay listens at the address that clients get
        port, inner_port, data_port = free_ports(3)
        arguments = ("--listen", f"{INNER}:{inner_port}", "--advertise", f"localhost:{port}", "--name", HOST_NAME)
        arguments += ("--data-port", str(data_port))
        access = ("--frontend", cluster.address, "--secret-file", str(cluster.secret_file))
        host = ServiceProcess("relayed host", "stampede_rt_channel_host", [*arguments, *access])
        with CuttingRelay({port: (INNER, inner_port), data_port: (INNER, data_port)}) as relay:
            try:
                host.start()
                host.wait_ready(READY_S)
                yield RelayedCluster(cluster, relay)
            finally:
                host.stop()
