"""Stampede RT with the host inside the producer's program, and readers in shared memory: two processes, one hop."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import stampede_rt as st
from stampede_rt_bench.clusters import SECRET_VARIABLE
from stampede_rt_bench.peers.ours import NAME, put_all, take_all
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds
from stampede_rt_bench.workloads.processes import ServerFailed
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed

LOOK_SECONDS = 0.02
LINGER_SECONDS = 1.0  # the host ends with its program, and the readers may have to take the last items
OPERATES_BY_REFERENCE = "the program of the host reads and puts by reference, without another process"


@dataclass(frozen=True)
class EmbeddedStampedeRt:
    """One channel of a host in the producer's process."""

    name: str = "Stampede RT, embedded host"

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return the workloads that run by reference: the program of the host needs no other process for them."""
        return dict.fromkeys(("put", "newest", "interval"), OPERATES_BY_REFERENCE)

    def unavailable_because(self) -> str | None:
        """Return None, because this package needs Stampede RT anyway."""
        return None

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run a supernode and a front-end for the duration of the context, and no host. Raises ServerFailed."""
        cluster = LocalCluster(hosts=0, supernodes=1, durable=False)
        try:
            cluster.start()
        except ServiceFailed as error:
            raise ServerFailed(str(error)) from error
        try:
            secret = {SECRET_VARIABLE: str(cluster.secret_file)}
            pids = [process.pid for process in cluster.processes()]
            yield RunningServer(address=cluster.address, pids=pids, environment=secret)
        finally:
            cluster.stop()

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> EmbeddedClient:
        """Return a client, which connects for each workload."""
        return EmbeddedClient(served.address, needs)


class EmbeddedClient:
    """A producer with a host, or a reader."""

    def __init__(self, address: str, needs: WorkloadNeeds) -> None:
        self._address, self._needs = address, needs

    def put(self, payloads: Iterator[bytes]) -> None:
        """Raises NotImplementedError: see `EmbeddedStampedeRt.unsupported`."""
        raise NotImplementedError

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Raises NotImplementedError: see `EmbeddedStampedeRt.unsupported`."""
        raise NotImplementedError

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Raises NotImplementedError: see `EmbeddedStampedeRt.unsupported`."""
        raise NotImplementedError

    def publish(self, steps: Iterator[Step]) -> None:
        """Host the channel, and put with a producer, whose payloads the host keeps as they are."""
        with st.host(self._address) as rt:
            put_all(rt.channel(NAME, max_items=self._needs.items_max), steps)
            time.sleep(LINGER_SECONDS)

    def subscribe(self, receiver: Receiver) -> None:
        """Subscribe to every item from the oldest one on, once the producer has made the channel.

        The producer stops while too many items are unread, so no item is lost before the subscription begins.
        """
        with st.connect(self._address, transport="shared") as rt:
            receiver.ready()
            while not receiver.ended():
                try:
                    channel = rt.channel(NAME, create=False)
                except st.ChannelNotFound:
                    time.sleep(LOOK_SECONDS)
                else:
                    take_all(channel.subscribe(start=st.OLDEST), receiver)

    def close(self) -> None:
        """Do nothing, because each workload closes its own connection."""
