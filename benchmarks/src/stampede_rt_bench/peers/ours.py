"""Stampede RT: a host, a supernode and a front-end as processes, and the synchronous client."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import stampede_rt as st
from stampede_rt_bench.clusters import SECRET_VARIABLE
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds
from stampede_rt_bench.workloads.processes import ServerFailed
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed

NAME = "bench/items"
LOOK_SECONDS = 0.05


@dataclass(frozen=True)
class StampedeRt:
    """One channel of a separate host. `transport`: see `stampede_rt.connect`."""

    name: str = "Stampede RT, gRPC"
    transport: str = "grpc"

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return an empty mapping: the system can run every kind of workload."""
        return {}

    def unavailable_because(self) -> str | None:
        """Return None, because this package needs Stampede RT anyway."""
        return None

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run a cluster of one supernode and one host for the duration of the context. Raises ServerFailed."""
        cluster = LocalCluster(hosts=1, supernodes=1, durable=False, data_ports=True)
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

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> StampedeClient:
        """Return a client with a new connection."""
        return StampedeClient(served.address, needs, self.transport)


class StampedeClient:
    """A client of the blocking public interface."""

    def __init__(self, address: str, needs: WorkloadNeeds, transport: str) -> None:
        self._rt = st.connect(address, transport=transport)
        self._channel = self._rt.channel(NAME, max_items=needs.items_max)

    def put(self, payloads: Iterator[bytes]) -> None:
        """Call `put` for each payload. It waits for the acknowledgement."""
        for payload in payloads:
            self._channel.put(payload)

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Call `newest` in each turn."""
        for _ in turns:
            item = self._channel.newest()
            if item is not None:
                receiver.take(item.time, item.seq, item.payload or b"")

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Call `get` from the oldest item on, with a limit, in each turn, and read the columns of the answer."""
        for items in turns:
            take_columns(self._channel.get(st.OLDEST, st.NEWEST, limit=items), receiver)

    def publish(self, steps: Iterator[Step]) -> None:
        """Put with a producer, which bounds the unacknowledged bytes."""
        put_all(self._channel, steps)

    def subscribe(self, receiver: Receiver) -> None:
        """Subscribe to every item."""
        subscription = self._channel.subscribe()
        receiver.ready()
        take_all(subscription, receiver)

    def close(self) -> None:
        """End the connection."""
        self._rt.close()


def put_all(channel: st.Channel, steps: Iterator[Step]) -> None:
    """Put the payloads of each step with a producer."""
    with channel.producer() as producer:
        for step in steps:
            if isinstance(step, float):
                time.sleep(step)
                continue
            for payload in step:
                producer.put(payload)


def take_all(subscription: st.Subscription, receiver: Receiver) -> None:
    """Give the receiver every item until it has ended."""
    threading.Thread(target=_close_at_end, args=(subscription, receiver), daemon=True).start()
    for batch in subscription.batches():
        take_columns(batch, receiver)


def take_columns(items: st.Items | st.ItemBatch, receiver: Receiver) -> None:
    """Give the receiver the time, the seq and the payload of each item."""
    for time_nanos, seq, payload in zip(items.times, items.seqs, items.payloads, strict=True):
        receiver.take(time_nanos, seq, payload or b"")


def _close_at_end(subscription: st.Subscription, receiver: Receiver) -> None:
    while not receiver.ended():
        time.sleep(LOOK_SECONDS)
    subscription.close()
