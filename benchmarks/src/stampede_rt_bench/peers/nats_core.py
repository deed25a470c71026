"""NATS core, through nats-py: publish and subscribe. It keeps no item, and acknowledges none."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from stampede_rt_bench.peers.nats_server import connect, nats_server, raise_first, why_unavailable
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds

SUBJECT = "bench.items"
LOOK_SECONDS = 0.05
KEEPS_NOTHING = "it keeps no items"


@dataclass(frozen=True)
class NatsCore:
    """One subject of one server."""

    name: str = "NATS core"

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return the kinds of workload that need stored items or acknowledgements."""
        return {"put": "it acknowledges nothing", "newest": KEEPS_NOTHING, "interval": KEEPS_NOTHING}

    def unavailable_because(self) -> str | None:
        """Return which package is missing, and how to install it; None if none is missing."""
        return why_unavailable()

    def served(self, needs: WorkloadNeeds) -> AbstractContextManager[RunningServer]:
        """Return a context with a new server without JetStream."""
        return nats_server()

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> NatsClient:
        """Return a client, which opens a connection for each workload."""
        return NatsClient(served.address)


class NatsClient:
    """A client that runs a new event loop for each workload."""

    def __init__(self, address: str) -> None:
        self._address = address

    def put(self, payloads: Iterator[bytes]) -> None:
        """Raises NotImplementedError: the system does not offer this workload."""
        raise NotImplementedError

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Raises NotImplementedError: the system does not offer this workload."""
        raise NotImplementedError

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Raises NotImplementedError: the system does not offer this workload."""
        raise NotImplementedError

    def publish(self, steps: Iterator[Step]) -> None:
        """Call `publish` for each payload. The client buffers up to 2 MiB, and writes them after each step."""
        asyncio.run(self._publish(steps))

    def subscribe(self, receiver: Receiver) -> None:
        """Read with a subscription that calls back. The client buffers at most 128 MiB for the callback."""
        asyncio.run(self._subscribe(receiver))

    def close(self) -> None:
        """Do nothing, because each workload closes its own connection."""

    async def _publish(self, steps: Iterator[Step]) -> None:
        connection = await connect(self._address)
        for step in steps:
            if isinstance(step, float):
                await asyncio.sleep(step)
                continue
            for payload in step:
                await connection.publish(SUBJECT, payload)
            await asyncio.sleep(0)
        await connection.flush()
        await connection.close()

    async def _subscribe(self, receiver: Receiver) -> None:
        failures: list[Exception] = []

        async def take(message: Any) -> None:
            receiver.take(0, 0, message.data)

        connection = await connect(self._address, failures)
        await connection.subscribe(SUBJECT, cb=take)
        await connection.flush()
        receiver.ready()
        while not receiver.ended() and not failures:  # noqa: ASYNC110 - another process ends it
            await asyncio.sleep(LOOK_SECONDS)
        await connection.close()
        raise_first(failures)
