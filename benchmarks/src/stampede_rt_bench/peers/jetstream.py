"""NATS JetStream, through nats-py: a stream in memory, pipelined publishes, direct gets, an ordered consumer."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AbstractContextManager, asynccontextmanager
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from stampede_rt_bench.peers.nats_server import connect, nats_server, raise_first, why_unavailable
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, Step, WorkloadNeeds

STREAM, SUBJECT = "BENCH", "bench.items"
LOOK_SECONDS = 0.05
CONSUMER_SECONDS, FETCH_SECONDS = 5.0, 5.0
MICROS_PER_SECOND, NANOS_PER_US = 1_000_000, 1000


@dataclass(frozen=True)
class JetStream:
    """One stream of one server."""

    name: str = "NATS JetStream"

    @property
    def unsupported(self) -> Mapping[str, str]:
        """Return an empty mapping: the system can run every kind of workload."""
        return {}

    def unavailable_because(self) -> str | None:
        """Return which package is missing, and how to install it; None if none is missing."""
        return why_unavailable()

    def served(self, needs: WorkloadNeeds) -> AbstractContextManager[RunningServer]:
        """Return a context with a new server that has JetStream."""
        return nats_server("--jetstream")

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> JetStreamClient:
        """Return a client, which opens a connection for each workload."""
        return JetStreamClient(served.address, needs)


class JetStreamClient:
    """A client that runs a new event loop for each workload."""

    def __init__(self, address: str, needs: WorkloadNeeds) -> None:
        self._address, self._needs = address, needs

    def put(self, payloads: Iterator[bytes]) -> None:
        """Call `publish` for each payload. It waits for the acknowledgement."""
        asyncio.run(self._put(payloads))

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the last message with a direct get."""
        asyncio.run(self._newest(turns, receiver))

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Fetch with a new consumer that acknowledges nothing. This takes less time than a batched direct get."""
        asyncio.run(self._interval(turns, receiver))

    def publish(self, steps: Iterator[Step]) -> None:
        """Call `publish_async` for each payload. At most 4000 publishes are unacknowledged, which is the default."""
        asyncio.run(self._publish(steps))

    def subscribe(self, receiver: Receiver) -> None:
        """Read with an ordered consumer, which needs no acknowledgements."""
        asyncio.run(self._subscribe(receiver))

    def close(self) -> None:
        """Do nothing, because each workload closes its own connection."""

    @asynccontextmanager
    async def _stream(self, failures: list[Exception] | None = None) -> AsyncIterator[Any]:
        from nats.js.api import RetentionPolicy, StorageType, StreamConfig

        connection = await connect(self._address, failures)
        stream = connection.jetstream()
        await stream.add_stream(
            StreamConfig(
                name=STREAM,
                subjects=[SUBJECT],
                storage=StorageType.MEMORY,
                retention=RetentionPolicy.LIMITS,
                max_msgs=self._needs.items_max,
                allow_direct=True,
            )
        )
        try:
            yield stream
        finally:
            await connection.close()

    async def _put(self, payloads: Iterator[bytes]) -> None:
        async with self._stream() as stream:
            for payload in payloads:
                await stream.publish(SUBJECT, payload)

    async def _newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        async with self._stream() as stream:
            for _ in turns:
                _take_raw(await stream.get_last_msg(STREAM, SUBJECT, direct=True), receiver)

    async def _interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        from nats.js.api import AckPolicy, ConsumerConfig, DeliverPolicy

        settings = ConsumerConfig(
            ack_policy=AckPolicy.NONE,
            deliver_policy=DeliverPolicy.ALL,
            mem_storage=True,
            inactive_threshold=CONSUMER_SECONDS,
        )
        async with self._stream() as stream:
            for items in turns:
                consumer = await stream.pull_subscribe(SUBJECT, stream=STREAM, config=settings)
                for message in await consumer.fetch(items, timeout=FETCH_SECONDS):
                    _take(message, receiver)
                await consumer.unsubscribe()

    async def _publish(self, steps: Iterator[Step]) -> None:
        async with self._stream() as stream:
            for step in steps:
                if isinstance(step, float):
                    await asyncio.sleep(step)
                    continue
                for payload in step:
                    await stream.publish_async(SUBJECT, payload)
                await asyncio.sleep(0)
            await stream.publish_async_completed()

    async def _subscribe(self, receiver: Receiver) -> None:
        failures: list[Exception] = []

        async def take(message: Any) -> None:
            _take(message, receiver)

        async with self._stream(failures) as stream:
            await stream.subscribe(SUBJECT, cb=take, ordered_consumer=True)
            receiver.ready()
            while not receiver.ended() and not failures:  # noqa: ASYNC110 - another process ends it
                await asyncio.sleep(LOOK_SECONDS)
        raise_first(failures)


def _take(message: Any, receiver: Receiver) -> None:
    data = message.metadata
    receiver.take(_nanos(data.timestamp), data.sequence.stream, message.data)


def _take_raw(message: Any, receiver: Receiver) -> None:
    """Give the receiver a message of a direct get. The time of such a message is the text of a header."""
    text = message.headers["Nats-Time-Stamp"]
    receiver.take(_nanos(datetime.fromisoformat(text[:26].rstrip("Z") + "+00:00")), message.seq, message.data)


def _nanos(instant: datetime) -> int:
    return int(instant.timestamp() * MICROS_PER_SECOND) * NANOS_PER_US
