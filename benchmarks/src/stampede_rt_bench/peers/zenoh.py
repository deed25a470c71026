"""Zenoh, with its Python package eclipse-zenoh: through a router, between peers, and between peers in shared memory.

Publishers block instead of dropping, as Zenoh's throughput examples do.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from stampede_rt_bench.peers.reachable import is_listening
from stampede_rt_bench.peers.zenoh_segments import segments_removed
from stampede_rt_bench.peers.zenoh_sessions import KEY, SHARED_MEMORY_BYTES, open_session
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds
from stampede_rt_bench.workloads.processes import server
from stampede_rt_local.ports import free_ports

LOOK_SECONDS, MEET_SECONDS, SETTLE_SECONDS = 0.05, 20.0, 0.2
STORED_SECONDS = 5.0
SHARED_BYTES_MIN = 3072  # the default of Zenoh's transport_optimization/message_size_threshold
NO_SERVER = "there is no server that keeps items"


@dataclass(frozen=True)
class Zenoh:
    """One key of Zenoh, over one of three ways."""

    way: Literal["router", "peer", "shared memory"]

    @property
    def name(self) -> str:
        """The name of the system in tables."""
        return {
            "router": "Zenoh, router",
            "peer": "Zenoh, peer to peer",
            "shared memory": "Zenoh, shared memory",
        }[self.way]

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return the workload that it cannot run: Zenoh acknowledges no put, and keeps items only with a router."""
        without = {"put": "it acknowledges no put"}
        return without if self.way == "router" else {**without, "newest": NO_SERVER, "interval": NO_SERVER}

    def unavailable_because(self) -> str | None:
        """Return how to install Zenoh; None if it is installed. It is a Python package."""
        return None if find_spec("zenoh") else 'Zenoh is not installed; pip install "stampede-rt-bench[peers]"'

    @contextmanager
    def served(self, needs: WorkloadNeeds) -> Iterator[RunningServer]:
        """Run a router in a new process. Without a router, only choose the address of the publisher."""
        (port,) = free_ports(1, "127.0.0.1")
        address = f"tcp/127.0.0.1:{port}"
        if self.way != "router":
            with segments_removed():
                yield RunningServer(address=address)
            return
        with tempfile.TemporaryDirectory(prefix="stampede-bench-") as folder:
            storage = [str(needs.items_max)] if needs.keeps else []
            command = [sys.executable, "-P", "-m", "stampede_rt_bench.peers.zenoh_router", address, *storage]
            with server(command, Path(folder, "log"), partial(is_listening, port)) as pid:
                yield RunningServer(address=address, pids=[pid])

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> ZenohClient:
        """Return a client, which opens a session for each workload."""
        return ZenohClient(self.way, served.address, needs)


class ZenohClient:
    """A client of Zenoh. Without a router the publisher listens, and readers connect to it."""

    def __init__(self, way: str, address: str, needs: WorkloadNeeds) -> None:
        self._way, self._address, self._needs = way, address, needs

    def put(self, payloads: Iterator[bytes]) -> None:
        """Raises NotImplementedError: the system does not offer this workload."""
        raise NotImplementedError

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the newest item from the router's storage."""
        self._get(turns, lambda items: f"{KEY}?newest=1", receiver)

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the oldest items from the router's storage. Zenoh does not merge the replies."""
        self._get(turns, lambda items: f"{KEY}?items={items}", receiver)

    def publish(self, steps: Iterator[Step]) -> None:
        """Call `put` of a declared publisher for each payload, once all readers have connected."""
        import zenoh

        with self._open(listens=self._way != "router") as session:
            publisher = session.declare_publisher(KEY, congestion_control=zenoh.CongestionControl.BLOCK)
            self._meet(session, publisher)
            send = self._sender(publisher)
            for step in steps:
                if isinstance(step, float):
                    time.sleep(step)
                    continue
                for payload in step:
                    send(payload)
            if self._needs.keeps:
                self._wait_until_stored(session)

    def subscribe(self, receiver: Receiver) -> None:
        """Read with a subscriber that calls back."""

        failures: list[Exception] = []

        def take(sample: Any) -> None:
            try:
                receiver.take(_nanos(sample), 0, sample.payload.to_bytes())
            except Exception as error:  # noqa: BLE001 - Zenoh would only print it
                failures.append(error)

        with self._open(listens=False) as session:
            subscriber = session.declare_subscriber(KEY, take)
            receiver.ready()
            while not receiver.ended() and not failures:
                time.sleep(LOOK_SECONDS)
            subscriber.undeclare()
        if failures:
            raise failures[0]

    def close(self) -> None:
        """Do nothing, because each workload closes its own session."""

    def _open(self, *, listens: bool) -> Any:
        mode: Literal["client", "peer"] = "client" if self._way == "router" else "peer"
        return open_session(mode, self._address, listens=listens, shared_memory=self._way == "shared memory")

    def _get(self, turns: Iterator[int], selector: Callable[[int], str], receiver: Receiver) -> None:
        import zenoh

        with self._open(listens=False) as session:
            for items in turns:
                for reply in session.get(selector(items), consolidation=zenoh.ConsolidationMode.NONE):
                    receiver.take(_nanos(reply.ok), 0, reply.ok.payload.to_bytes())

    def _meet(self, session: Any, publisher: Any) -> None:
        """Wait until all readers have connected. Raises TimeoutError."""
        until_s = time.monotonic() + MEET_SECONDS
        readers = 0 if self._way == "router" else self._needs.readers
        while not publisher.matching_status.matching or len(session.info.peers_zid()) < readers:
            if time.monotonic() > until_s:
                raise TimeoutError(f"the readers did not come within {MEET_SECONDS:g} s")
            time.sleep(0.01)
        time.sleep(SETTLE_SECONDS)

    def _wait_until_stored(self, session: Any) -> None:
        """Wait until the storage has items, which takes a moment after the put. Raises TimeoutError."""
        until_s = time.monotonic() + STORED_SECONDS
        while not any(True for _ in session.get(f"{KEY}?newest=1")):
            if time.monotonic() > until_s:
                raise TimeoutError(f"no item was stored within {STORED_SECONDS:g} s")
        time.sleep(SETTLE_SECONDS)

    def _sender(self, publisher: Any) -> Callable[[bytes], None]:
        """Return the function that puts one payload.

        With shared memory it first copies the payload into a shared buffer, if the payload reaches Zenoh's threshold.
        """
        if self._way != "shared memory" or self._needs.item_bytes < SHARED_BYTES_MIN:
            put: Callable[[bytes], None] = publisher.put
            return put
        from zenoh.shm import BlockOn, Defragment, GarbageCollect, ShmProvider

        provider = ShmProvider.default_backend(SHARED_MEMORY_BYTES)
        policy = BlockOn(GarbageCollect(Defragment()))

        def send(payload: bytes) -> None:
            buffer = provider.alloc(len(payload), policy=policy)
            buffer[:] = payload
            publisher.put(buffer)

        return send


def _nanos(sample: Any) -> int:
    return int(sample.timestamp.get_time_as_ntp64().as_nanos())
